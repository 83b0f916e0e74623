#include "feltmb/fiber/felt_material.hpp"

#include <algorithm>

#include "feltmb/core/error.hpp"
#include "feltmb/fiber/faults.hpp"

namespace feltmb {
namespace {

SlidingNetwork network_of(const FeltMaterial& m, const FeltBranch& branch) {
  return {m.mu, m.Wf0, m.d_f, m.v_f0, branch.gamma, m.Q};
}

std::unique_ptr<const CompressionLaw> elastic_law(const FeltMaterial& m, const FeltBranch& branch) {
  return make_law("binomial",
                  {{"K_p", branch.K_p}, {"gamma", branch.gamma}, {"v_f0", m.v_f0}, {"Q", m.Q}});
}

}  // namespace

void validate(const FeltMaterial& m, const char* where) {
  Faults faults(where);
  faults.positive("friction mu", m.mu, "");
  faults.positive("withdrawal force Wf0", m.Wf0, "N/m");
  faults.positive("fiber diameter d_f", m.d_f, "m");
  faults.positive("Q", m.Q, "");
  if (!(m.v_f0 > 0.0 && m.v_f0 < 1.0)) faults.add("v_f0", m.v_f0, "", "> 0 and < 1");
  if (!(m.v_f_max > m.v_f0 && m.v_f_max < 1.0)) {
    faults.add("v_f_max", m.v_f_max, "", "> v_f0 and < 1 (the end of the loop)");
  }
  for (const auto* branch : {&m.loading, &m.unloading}) {
    const char* name = branch == &m.loading ? "loading" : "unloading";
    faults.positive((std::string(name) + " K_p").c_str(), branch->K_p, "Pa");
    faults.positive((std::string(name) + " gamma").c_str(), branch->gamma, "");
  }
  faults.raise_if_any();
}

FeltPressure::FeltPressure(const FeltMaterial& material) : material_(material) {
  validate(material, "felt");
  load_ = elastic_law(material, material.loading);
  unload_ = elastic_law(material, material.unloading);
}

double FeltPressure::loading(double v) const {
  const double sigma = load_->pressure(v);
  if (sigma <= 0.0) return 0.0;
  const SlidingNetwork network = network_of(material_, material_.loading);
  return sigma + sliding_at_pressure(network, v, sigma, Stress::elastic).tau_loading;
}

double FeltPressure::unloading(double v) const {
  const double sigma = unload_->pressure(v);
  if (sigma <= 0.0) return 0.0;
  const SlidingNetwork network = network_of(material_, material_.unloading);
  const double tau = sliding_at_pressure(network, v, sigma, Stress::elastic).tau_unloading;
  return std::max(0.0, sigma - tau);
}

}  // namespace feltmb
