#pragma once

#include <memory>
#include <tuple>
#include <vector>

#include "feltmb/contact/laws/concept.hpp"

namespace feltmb {

/// Rate-independent felt with return-point memory (Madelung's rules).
///
/// Loop and virgin loading are those of felt_memory: F_L(e), and F_U = F_L rho(e / e_m) in the
/// cycle to e_m, the largest compression so far. Below e_m
///   F = F_U + y D,  D = F_L - F_U,
/// where y in [0, 1] follows from the turning points. With G(e) = integral of F_L from e to e_m and
/// m = 2 / kappa, from the last turning point k
///   y = y_k + 1 - (G / G_k)^m  rising,   y = y_k - 1 + (G_k / G)^m  falling,
/// y = 0 falling from e_m: the measured curve. In x = -m ln G both are y_k +- (1 - exp(-|x -
/// x_k|)): branches depend on the way since the turning point alone (congruency), a loop that
/// closes ends at the force where it began (return point), and goes on along the branch that it
/// interrupted (wiping out). The first rise after a full release has y = 1 - (1 - q)^(1 / kappa),
/// with the share q = 1 - (G / G(0))^2 of the area of a band that closes in proportion to G;
/// felt_memory has 1 - exp(-q / kappa).
///
/// Stored energy psi: what the felt gives back if it is let go from here,
///   psi = integral of F_U + y_f D from 0 to e,  y_f falling from (e, y).
/// Falling, the heat is zero; rising at fixed e_m it is
///   m (F_L / G) de/dt integral of [(G(e) / G')^m - (G(e) / G_k)^m] D' from e_k to e  >= 0,
/// and W'(e_m) de_m/dt on virgin loading: passive for kappa in (0, 2] and any history.
///
/// Rises and falls are told apart by the turning points, not by the rate: between two of them, the
/// force is a function of the compression.
struct FeltReturnPoint {
  static constexpr double nothing = 1e-150;  ///< below this e_m [m] a felt counts as virgin
  std::shared_ptr<const Envelope> envelope;
  double kappa = 0.2;          ///< transition length over the loop [-], in (0, 2]
  double recovery_time = 0.0;  ///< [s], 0: none

  static constexpr LawName kNames[] = {
      {"felt_return_point", "as felt_memory, with return-point memory: for small vibrations"}};
  static constexpr const char* kTable = "memory";
  static constexpr auto fields() {
    using L = FeltReturnPoint;
    return std::tuple{
        entry("envelope", &L::envelope, "loop: a pair of curves, or a table"),
        number("kappa", &L::kappa, "1", up_to(above(0.0), 2.0), "transition length over the loop"),
        number("recovery_time", &L::recovery_time, "s", at_least(0.0),
               "of the largest compression while open; 0: none")};
  }

  static constexpr bool kRemembers = true;
  const Envelope* cycle_envelope() const { return envelope.get(); }
  std::size_t n_states() const { return 0; }
  LawState state(std::size_t, double) const { return {"", 1.0}; }
  void relax(double, double*) const {}

  LawValue force(double e, double rate, const LawMemory& memory, LawStates& states) const;
  CurveValue rest_force(double e) const { return envelope->loading(e); }
  double rest_energy(double e) const { return envelope->loading_energy(e); }
  double energy(double e, const LawMemory& memory) const;
  double dissipated_power(double e, double rate, const LawMemory& memory) const;
  int piece(double e, double rate, const LawMemory& memory) const;

  void turn(double e, double largest, TurningPoints& turns) const;
  /// Exact: the force depends on the path only.
  bool advance(PathPoint& at, double compression, double duration) const;

 private:
  double apart(double e, double largest) const;
  CurveValue position(double e, double largest, const TurningPoints& turns, std::size_t n) const;
  double band_energy(double e, double largest, const TurningPoints& turns, std::size_t n) const;
};

}  // namespace feltmb
