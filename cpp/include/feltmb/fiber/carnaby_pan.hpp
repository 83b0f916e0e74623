/// Friction hysteresis of a fiber mass: sliding and sticking contacts after Carnaby and Pan.
///
/// Symbols: theta polar angle of a fiber from the direction of compression; C mean contact force
/// along it [N]; lambda mean free length; n = 2 v K_3 / (pi d^2) contacts per area (eq. 3.62),
/// K_3 = 1 / (1 + R), R = v_f / v_f0; w = Wf0 lambda / C.
/// A contact slides if C cos(theta) >= mu C sin(theta) + Wf0 lambda (eq. 3.65), that is below the
/// critical angle; both caps of the half sphere slide. Per contact that slides, averaged over them,
///   C_s loading   = < Wf0 lambda / (cos(theta) - mu sin(theta)) >   (eq. 3.71),
///   C_s unloading = < Wf0 lambda / cos(theta) >                     (eq. 3.76),
/// and the pressures are (eqs 3.67, 3.68, total form)
///   P = sigma + r_sc n C_s (loading),  sigma - r_sc n C_s (unloading),  sigma = (1 - r_sc) n C.
/// Orientation: Omega of feltmb/fiber/orientation.hpp. Binomial free length (eq. 3.15).
/// Sources: thesis 3.3, eqs 3.58-3.77 with repairs (docs/explanation/felt.md); G. A. Carnaby and N.
/// Pan [14]. Valid for v_f >= v_f0 and quasi-static, uniaxial compression; elastic fibers. Cannot
/// show: the transition at a reversal (the two branches are envelopes).
#pragma once

#include <span>
#include <vector>

namespace feltmb {

/// Parameters of a fiber mass for friction.
struct SlidingNetwork {
  double mu;       ///< friction coefficient between fibers [-], >= 0
  double Wf0;      ///< withdrawal force per fiber length at no load [N/m], > 0
  double d_f;      ///< fiber diameter [m], > 0
  double v_f0;     ///< volume fraction without load, random orientation [-], in (0, 1)
  double gamma;    ///< blocked length per contact over d_f [-], > 0
  double Q = 2.0;  ///< [-] > 0; 2: random in space
};

/// Throws InvalidParameter with all faults; each line starts with `where`.
void validate(const SlidingNetwork& network, const char* where);

/// Sliding at one volume fraction and contact force.
struct Sliding {
  double C = 0.0;              ///< contact force [N]
  double theta_cr = 0.0;       ///< critical angle [rad], 0 while nothing slides
  double r_sc = 0.0;           ///< proportion of contacts that slide [-]
  double C_s_loading = 0.0;    ///< [N], Wf0 lambda while nothing slides
  double C_s_unloading = 0.0;  ///< [N], Wf0 lambda while nothing slides
  double sigma = 0.0;          ///< (1 - r_sc) n C [Pa]
  double tau_loading = 0.0;    ///< r_sc n C_s_loading [Pa]
  double tau_unloading = 0.0;  ///< r_sc n C_s_unloading [Pa]
};

/// Critical angle [rad] at w = Wf0 lambda / C: acos(w / sqrt(1 + mu^2)) - atan(mu) for w < 1, else
/// 0 (eq. 3.66 with its + root); tends to atan(1 / mu) as w -> 0.
double critical_angle(double w, double mu);

/// Proportion of contacts that slide below theta [rad], both caps:
/// 1 - R c / sqrt(s^2 + R^2 c^2) (eq. 3.69).
double sliding_proportion(double ratio, double theta);

/// r_sc C_s / (Wf0 lambda) of eq. 3.71: the integral over both caps up to theta of
/// Omega sin / (cos - mu sin); mu = 0 gives eq. 3.76. Relative error below 1e-12.
/// Requires cos(theta) > mu sin(theta).
double sliding_resistance(double ratio, double mu, double theta);

/// Sliding at contact force C [N]; for C < 0 nothing slides, and C is returned unchanged.
Sliding sliding_at_force(const SlidingNetwork& network, double v_f, double C);

/// Kind of the known pressure.
enum class Stress {
  elastic,   ///< sigma
  loading,   ///< sigma + tau_loading
  unloading  ///< sigma - tau_unloading
};

/// Sliding for one known pressure [Pa]. If the unloading pressure does not increase with C
/// everywhere (which happens for mu below 0.30 at R = 1, and below 0.1 at R = 2), there may be
/// several contact forces: the largest one is used, and `unique` is set to false. Throws
/// InvalidParameter if mu = 0 bounds sigma below the pressure.
Sliding sliding_at_pressure(const SlidingNetwork& network, double v_f, double pressure, Stress kind,
                            bool* unique = nullptr);

/// Whether the unloading pressure increases with the contact force everywhere, at R and mu.
bool unloading_is_unique(double ratio, double mu);

/// Repaired: both caps, average over the sliding contacts, total form. Printed: one cap (half the
/// proportion), C_s not divided by the proportion, pressures summed from increments with P
/// continuous at the reversal (eqs 3.73, 3.77); |cos| in K_3 in both, since the printed K_3 is 0.
enum class FrictionForm { repaired, printed };

/// One loop, loading from v_f0 and unloading from the largest v_f; arrays of equal length.
struct CarnabyPanLoop {
  std::vector<double> v_f, C, theta_cr, r_sc, C_s_loading, C_s_unloading, sigma_el, P_loading,
      P_unloading;
};

/// Compression-driven: C from dC/dv = k_bend E I K_3 / (M_3 lambda^2 v), C(v_f0) = 0 (eq. 3.74 with
/// the strain of a cell, d delta = lambda K_3 dv / v).
/// @param E       fiber modulus [Pa], > 0
/// @param k_bend  beam constant K_p of eq. 3.74 [-], > 0; 24 for clamped ends
/// @param v_f     volume fractions [-], growing, v_f0 <= v_f < 1
/// Throws InvalidParameter naming every fault.
CarnabyPanLoop carnaby_pan(const SlidingNetwork& network, double E, double k_bend,
                           std::span<const double> v_f, FrictionForm form = FrictionForm::repaired);

/// Load-driven march of section 3.3.1: contact forces are given, v_f follows by steps of
/// fourth order, `substeps` between neighbors.
/// @param C  contact forces [N], growing, >= 0
CarnabyPanLoop carnaby_pan_march(const SlidingNetwork& network, double E, double k_bend,
                                 std::span<const double> C, int substeps = 8,
                                 FrictionForm form = FrictionForm::repaired);

}  // namespace feltmb
