// Uses the installed headers and library: the version, an error, and two felts that remember.
#include <cstdio>

#include "feltmb/contact/felt_layer.hpp"
#include "feltmb/contact/path.hpp"
#include "feltmb/core/error.hpp"

namespace {

/// A sphere pressed 0.4 mm deep, let go to 0.2 mm and pressed again.
void press(const char* name, const feltmb::ContactLaw& law) {
  feltmb::LawPath felt(law);
  std::printf("%s", name);
  for (const double compression : {2e-4, 4e-4, 2e-4, 4e-4}) {
    std::printf(" %.9g", felt.step(compression, 1e-3));
  }
  std::printf("\n");
}

}  // namespace

int main() {
  try {
    throw feltmb::InvalidParameter(feltmb::format("stiffness = %.6g N/m", -4e8));
  } catch (const feltmb::Error& error) {
    std::printf("%s\n%s\n", FELTMB_VERSION, error.what());
  }

  // The curve fits of Table A.12, row 1.
  feltmb::FeltMemory memory;
  memory.envelope =
      feltmb::Envelope::from_curves({5.52e3, 1.58e3, -0.60e3}, {0.19e3, 5.04e3, 3.04e3});
  press("felt_memory", feltmb::ContactLaw(memory));

  // A felt 6 mm thick under a sphere of 9 mm radius, column by column.
  feltmb::FeltMaterial material;
  material.mu = 0.35;
  material.Wf0 = 0.8;
  material.d_f = 25e-6;
  material.v_f0 = 0.132;
  material.v_f_max = 0.33;
  material.loading = {4.0e6, 1.3};
  material.unloading = {3.82e5, 3.16};
  feltmb::FeltMemory layer;
  layer.envelope =
      feltmb::layer_envelope({feltmb::pressure_envelope(material), 6e-3,
                              feltmb::SphereOnLayer{9e-3}, feltmb::LayerCompression::kColumns});
  press("micromechanical", feltmb::ContactLaw(layer));
}
