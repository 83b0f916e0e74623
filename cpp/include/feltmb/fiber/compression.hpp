/// Compression laws of fiber networks: pressure against volume fraction, one interface.
///
/// Conventions: pressure P > 0 in compression [Pa]; v = v_f volume fraction [-]; v0 = v_f0 the
/// fraction at which P is defined to be zero. Below v0 a network carries nothing: P = P' = U = 0.
/// True strain of uniaxial compression d(strain) = dv / v; engineering strain 1 - v0 / v (eq. 2.2,
/// compression positive). Stored energy U(v) = int_{v0}^v P dv / v^2 [J per m^3 of fiber]; per
/// volume of the uncompressed assembly it is v0 U. Lateral dimensions are held, except where a
/// law says otherwise.
/// Laws are immutable after construction and safe to share between threads.
#pragma once

#include <map>
#include <memory>
#include <span>
#include <string>
#include <vector>

namespace feltmb {

/// One parameter of a law; checks, fits, command line and documents use this description.
struct LawParameter {
  std::string name;      ///< ASCII name as in the thesis ("k_p", "v_fm", ...)
  std::string unit;      ///< SI unit, "" when dimensionless
  double default_value;  ///< NaN when it must be given
  double low;            ///< permitted from, exclusive when low_open
  double high;           ///< permitted to
  bool low_open;         ///< true: value > low, false: value >= low
  double fit_low;        ///< usual range of a fit, inside the permitted one
  double fit_high;       ///< upper end of it
  bool log_scale;        ///< a fit works with the logarithm
  std::string meaning;   ///< one line
};

/// Name, parameters and source of a law.
struct LawDescription {
  std::string name;
  std::string title;   ///< one line
  std::string source;  ///< thesis equation and authors
  std::string validity;
  std::vector<LawParameter> parameters;
};

/// A pressure law with its parameters.
class CompressionLaw {
 public:
  virtual ~CompressionLaw() = default;
  CompressionLaw(const CompressionLaw&) = delete;
  CompressionLaw& operator=(const CompressionLaw&) = delete;

  /// Fraction of zero pressure [-].
  [[nodiscard]] double reference() const { return v0_; }
  /// The law is finite for v < limit() [-] (v <= 1 if limit() is above 1).
  [[nodiscard]] double limit() const { return limit_; }

  /// P(v) [Pa]; 0 for v <= v0. Not checked: v must be below limit().
  [[nodiscard]] double pressure(double v) const { return v <= v0_ ? 0.0 : pressure_at(v); }
  /// dP/dv [Pa] on the loaded side; 0 for v < v0. The tangent modulus for uniaxial compression
  /// with respect to true strain is v dP/dv.
  [[nodiscard]] double slope(double v) const { return v < v0_ ? 0.0 : slope_at(v); }
  /// U(v) [J/m^3 of fiber]; 0 for v <= v0.
  [[nodiscard]] double energy(double v) const { return v <= v0_ ? 0.0 : energy_at(v); }

  /// v with P(v) = pressure [-]; P must lie in [0, P(v_max)]. Bracketed Newton to rounding.
  [[nodiscard]] double volume_fraction(double pressure, double v_max) const;

 protected:
  CompressionLaw(double v0, double limit) : v0_(v0), limit_(limit) {}
  [[nodiscard]] virtual double pressure_at(double v) const = 0;
  [[nodiscard]] virtual double slope_at(double v) const = 0;
  [[nodiscard]] virtual double energy_at(double v) const = 0;
  double v0_;
  double limit_;
};

/// Every law that make_law knows:
///   van_wyk        eq. 2.1   P = k_p E (v^3 - v0^3)
///   neckar         eq. 2.5   k_p E v^3 / (1 - (v/v_fm)^3)^3, less its value at v0
///   stamm          2.2.1     the same with contact volume W/V = v^3 / (v_fm^2 w_f); w_f = v_fm
///                            gives neckar (judged: Stamm's own text was not available)
///   toll_planar    eq. 2.8   P = 512 E f^4 (v^5 - v0^5) / (5 pi^4)
///   narter         eq. 3.27  dP/dv = K_E E <cos^4>(R) (1 - exp(-Q gamma v)) / gamma, R =
///   v/v_random
///                            (increments; N_fv d_f = 2 N_v d_f of eq. 3.15)
///   alkhagen_toll  eq. 3.55  d(P v)/dv = v E f^4 v^4 (256 k_b/pi^4 <n3^4>_c +
///                            beta^2 <e3^4>_c / (pi^2 f^2 v^2/k_t + 3 pi^4/(256 k_b))), by
///                            quadrature
///   binomial       eq. 3.64  x = Q gamma v: K_p ((e^x-1)/(Q gamma))^3 (e^-x/2 + 3/2 - (1-e^-x)/x),
///                            less its value at v0 (errata E13)
///   bending_chain  eqs. 3.58-3.63 with 3.15 taken literally: dP/dv = K_p E K_3^2 (1-e^-x)^2 /
///                            (32 M_3 gamma^2); isotropic, or following R = v/v_random if given
///   komori_itoh    2.2.1     straight segments bent to arcs, lateral dimensions held; P(v0+) > 0:
///                            segments must buckle first (see energy_method.hpp)
///   komori_itoh_renewed    the same, but segments and contacts are those of the present fraction
///                          in every increment: P = (48/pi^2) E f^2 <cos^2> v^3 less its value at
///                          v0
///   lee_carnaby    2.2.1     the same with crimped segments, P(v0) = 0
const std::vector<LawDescription>& law_descriptions();

/// Description of one law. Throws InvalidParameter listing the names.
const LawDescription& law_description(const std::string& name);

/// A law from its parameters. Missing ones take their default ("v_random": v_f0).
/// Throws InvalidParameter naming every unknown, missing and out-of-range parameter at once.
std::unique_ptr<const CompressionLaw> make_law(const std::string& name,
                                               const std::map<std::string, double>& parameters);

/// Which function of a law evaluate_law computes.
enum class LawQuantity { pressure, slope, energy };

/// Evaluates a law at many fractions with `threads` threads (0: all cores).
/// @param v    volume fractions [-]; 0 < v <= 1 and v < limit(). Throws InvalidParameter naming
///             the first places where that fails.
/// @param out  same size as v
void evaluate_law(const CompressionLaw& law, LawQuantity quantity, std::span<const double> v,
                  std::span<double> out, std::size_t threads = 0);

}  // namespace feltmb
