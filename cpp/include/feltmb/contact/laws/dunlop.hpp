#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <tuple>

#include "feltmb/contact/laws/concept.hpp"

namespace feltmb {

/// Dunlop's units in series under one force (thesis section 2.2.2): a spring without friction and
/// three springs with a sliding block each. Unit i carries s_i = k (4 x_i)^p at its share x_i of
/// the compression, so that all together carry k e^p without friction. Its block holds up to
/// f_i + phi s_i: it slides where |F - s_i| is more,
///   F = k (4 (e - x_1 - x_2 - x_3))^p,   c dx_i/dt = F - s_i -+ (f_i + phi s_i),
/// slowed by the damping c only, which a force over a length needs to be a function of both; the
/// smaller c, the nearer to dry friction. Remembers turning points, keeps a residual compression.
/// Three states x_i [m], which go on while open. Stored energy: that of the springs; heat
/// (F - s_i) dx_i/dt >= 0: passive. A block with constant friction that has come to rest while open
/// lies on the corner between sliding and sticking: derivatives of a run by parameters, which are
/// taken there by small shifts, miss what its rest depends on.
struct Dunlop {
  double stiffness = 0.0;   ///< k [N/m^p], > 0
  double exponent = 1.5;    ///< p [-], >= 1
  double share = 0.0;       ///< phi [-], in [0, 1)
  double friction_1 = 0.0;  ///< f_1 [N], >= 0
  double friction_2 = 0.0;  ///< f_2 [N], >= 0
  double friction_3 = 0.0;  ///< f_3 [N], >= 0
  double damping = 1.0;     ///< c [N s/m], > 0

  static constexpr std::size_t kBlocks = 3;
  static constexpr double kUnits = 4.0;
  static constexpr LawName kNames[] = {
      {"dunlop",
       "springs with sliding blocks in series, rate independent but for a small damping"}};
  static constexpr auto fields() {
    using L = Dunlop;
    return std::tuple{
        number("stiffness", &L::stiffness, "N/m^p", above(0.0), "k"),
        number("exponent", &L::exponent, "1", at_least(1.0), "p"),
        number("share", &L::share, "1", below(at_least(0.0), 1.0),
               "phi, friction over the force of the spring"),
        number("friction_1", &L::friction_1, "N", at_least(0.0), "constant friction of block 1"),
        number("friction_2", &L::friction_2, "N", at_least(0.0), "of block 2"),
        number("friction_3", &L::friction_3, "N", at_least(0.0), "of block 3"),
        number("damping", &L::damping, "N s/m", above(0.0),
               "c, of a block that slides; small against k times a slow time")};
  }

  std::size_t n_states() const { return kBlocks; }
  LawState state(std::size_t i, double compression) const {
    static constexpr const char* names[] = {"block1", "block2", "block3"};
    return {names[i], compression};
  }
  /// A virgin felt that is pressed slides: s_i = (F - f_i)/(1 + phi).
  void relax(double e, double* state) const {
    const double f = e > 0.0 ? rest_force(e).force : 0.0;
    for (std::size_t i = 0; i < kBlocks; ++i) state[i] = length(held(i, f));
  }

  LawValue force(double e, double, const LawMemory& memory, LawStates& s) const {
    s = {};
    const double* x = memory.state;
    const CurveValue first = spring(e - x[0] - x[1] - x[2]);
    const bool on = e > 0.0;
    const double f = on ? first.force : 0.0;
    const double slope = on ? first.slope : 0.0;
    for (std::size_t i = 0; i < kBlocks; ++i) {
      s.force[i] = -slope;
      const CurveValue own = spring(x[i]);
      const int way = slides(f, own.force, i);
      if (way == 0) continue;
      s.rate[i] = excess(f, own.force, i, way) / damping;
      s.rate_by_compression[i] = slope / damping;
      for (std::size_t j = 0; j < kBlocks; ++j) s.rate_by_state[i][j] = -slope / damping;
      s.rate_by_state[i][i] -= own.slope * (1.0 + way * share) / damping;
    }
    return {f, slope, 0.0};
  }
  CurveValue rest_force(double e) const {
    // The compression grows with the force: bisection from below k e^p, which friction exceeds.
    const auto compression = [&](double f) {
      double sum = length(f);
      for (std::size_t i = 0; i < kBlocks; ++i) sum += length(held(i, f));
      return sum;
    };
    double low = 0.0;
    double high = stiffness * std::pow(e, exponent) + 1e-300;
    while (compression(high) < e) high *= 2.0;
    for (int i = 0; i < 200 && high - low > 1e-15 * high; ++i) {
      const double middle = 0.5 * (low + high);
      (compression(middle) < e ? low : high) = middle;
    }
    double compliance = 1.0 / spring(length(high)).slope;
    for (std::size_t i = 0; i < kBlocks; ++i) {
      const double x = length(held(i, high));
      if (x > 0.0) compliance += 1.0 / (spring(x).slope * (1.0 + share));
    }
    return {high, 1.0 / compliance};
  }
  double energy(double e, const LawMemory& memory) const {
    const double* x = memory.state;
    double sum = e > 0.0 ? work(e - x[0] - x[1] - x[2]) : 0.0;
    for (std::size_t i = 0; i < kBlocks; ++i) sum += work(x[i]);
    return sum;
  }
  double dissipated_power(double e, double rate, const LawMemory& memory) const {
    LawStates s;
    const double f = force(e, rate, memory, s).force;
    double sum = 0.0;
    for (std::size_t i = 0; i < kBlocks; ++i) {
      sum += (f - spring(memory.state[i]).force) * s.rate[i];
    }
    return sum;
  }
  /// What slides and which way.
  int piece(double e, double rate, const LawMemory& memory) const {
    LawStates s;
    const double f = force(e, rate, memory, s).force;
    int number = f > 0.0 ? 1 : 0;
    for (std::size_t i = 0; i < kBlocks; ++i) {
      number = 3 * number + 1 + slides(f, spring(memory.state[i]).force, i);
    }
    return number;
  }
  void limit(double* state) const {
    for (std::size_t i = 0; i < kBlocks; ++i) state[i] = std::max(0.0, state[i]);
  }

 private:
  CurveValue spring(double x) const {
    if (x <= 0.0) return {0.0, 0.0};
    const double f = stiffness * std::pow(kUnits * x, exponent);
    return {f, exponent * f / x};
  }
  double work(double x) const { return x > 0.0 ? spring(x).force * x / (exponent + 1.0) : 0.0; }
  double length(double f) const {
    return f > 0.0 ? std::pow(f / stiffness, 1.0 / exponent) / kUnits : 0.0;
  }
  double constant(std::size_t i) const { return std::array{friction_1, friction_2, friction_3}[i]; }
  /// Spring force of a block that has slid under a growing force.
  double held(std::size_t i, double f) const {
    return std::max(0.0, (f - constant(i)) / (1.0 + share));
  }
  double excess(double f, double s, std::size_t i, int way) const {
    return f - s - way * (constant(i) + share * s);
  }
  /// 1: is pressed on, -1: comes back, 0: sticks.
  int slides(double f, double s, std::size_t i) const {
    if (excess(f, s, i, 1) > 0.0) return 1;
    return excess(f, s, i, -1) < 0.0 ? -1 : 0;
  }
};

}  // namespace feltmb
