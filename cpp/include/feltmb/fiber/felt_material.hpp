/// A felt as a material: pressure of loading and unloading with friction between its fibers.
#pragma once

#include <memory>
#include <string>

#include "feltmb/fiber/carnaby_pan.hpp"
#include "feltmb/fiber/compression.hpp"

namespace feltmb {

/// Elastic law of one branch: eq. 3.64 less its value at v_f0.
struct FeltBranch {
  double K_p = 0.0;    ///< [Pa], > 0
  double gamma = 0.0;  ///< blocked length per contact over the fiber diameter [-], > 0
};

/// Fibers and both branches of a felt (thesis 3.3.2, docs/explanation/felt.md).
struct FeltMaterial {
  double mu = 0.0;       ///< friction coefficient between fibers [-], > 0
  double Wf0 = 0.0;      ///< withdrawal force per fiber length at no load [N/m], > 0
  double d_f = 0.0;      ///< fiber diameter [m], > 0
  double v_f0 = 0.0;     ///< volume fraction without load [-], in (0, 1)
  double v_f_max = 0.0;  ///< end of the loop [-], in (v_f0, 1)
  double Q = 2.0;        ///< [-], > 0; 2: random in space
  FeltBranch loading;
  FeltBranch unloading;
};

/// Throws InvalidParameter naming every fault.
void validate(const FeltMaterial& material, const char* where);

/// Pressures of a material at any volume fraction; immutable.
///
/// sigma of eq. 3.64 gives the contact force, hence the critical angle and the friction of each
/// branch: P_L = sigma_L + r_sc n C_sL, P_U = sigma_U - r_sc n C_sU (eqs 3.67, 3.68).
class FeltPressure {
 public:
  /// Throws InvalidParameter naming every fault.
  explicit FeltPressure(const FeltMaterial& material);

  const FeltMaterial& material() const { return material_; }

  /// P_L and P_U >= 0 [Pa] at volume fraction v [-] < 1; 0 for v <= v_f0.
  double loading(double v) const;
  double unloading(double v) const;

 private:
  FeltMaterial material_;
  std::unique_ptr<const CompressionLaw> load_, unload_;
};

}  // namespace feltmb
