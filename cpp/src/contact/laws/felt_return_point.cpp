#include "feltmb/contact/laws/felt_return_point.hpp"

#include <algorithm>
#include <cmath>

#include "feltmb/numeric/quadrature.hpp"

namespace feltmb {
namespace {

const TurningPoints& none() {
  static const auto& empty = *new TurningPoints();
  return empty;
}

const TurningPoints& turns_of(const LawMemory& memory) {
  return memory.turns != nullptr ? *memory.turns : none();
}

/// Eight nodes for each factor exp(2) of a power of G. Energies take at least its 24th power, as
/// the ratio of the branches of D bends, and come back to 2e-7; a power that is lost has 1e-5.
constexpr double kOfEnergy = 24.0;
const QuadratureRule& panel_rule() {
  static const QuadratureRule& rule = *new QuadratureRule(make_gauss_legendre(8));
  return rule;
}

/// Integral of D weight(G) between compressions within the cycle to e_m [J]: in the logarithm of
/// the distance to e_m, where a power of G is smooth.
template <class Weight>
double integrate_band(const Envelope& envelope, double low, double high, double largest,
                      double power, Weight&& weight) {
  const double near = std::max(largest - high, 1e-8 * largest);
  const double span = std::log((largest - low) / near);
  if (!(span > 0.0)) return 0.0;
  const CycleStart cycle = envelope.cycle_to(largest);
  const double whole = envelope.loading_energy(largest);
  const double panels = std::clamp(std::ceil(power * span / 2.0), 1.0, 24.0);
  double sum = 0.0;
  for (double i = 0.0; i < panels; i += 1.0) {
    sum += integrate_rule(
        panel_rule(),
        [&](double s) {
          const double distance = near * std::exp(s);
          const double e = largest - distance;
          const CycleValue v = envelope.cycle(e, cycle);
          const double apart = std::max(0.0, whole - envelope.loading_energy(e));
          return weight(apart) * v.loading * (1.0 - v.ratio) * distance;
        },
        span * i / panels, span * (i + 1.0) / panels);
  }
  return sum;
}

}  // namespace

std::size_t left_at(double e, const TurningPoints& turns) {
  std::size_t n = turns.size();
  while (n > 0) {
    const double from = turns[n - 1].compression;
    const bool rises = n % 2 == 1;
    if (rises ? e < from : e > from) {
      --n;
    } else if (n > 1 && (rises ? e >= turns[n - 2].compression : e <= turns[n - 2].compression)) {
      n -= 2;
    } else {
      break;
    }
  }
  return n;
}

/// G [J].
double FeltReturnPoint::apart(double e, double largest) const {
  return std::max(0.0, envelope->loading_energy(largest) - envelope->loading_energy(e));
}

/// y, and its slope over F_L, with n turning points left.
CurveValue FeltReturnPoint::position(double e, double largest, const TurningPoints& turns,
                                     std::size_t n) const {
  if (n == 0) return {0.0, 0.0};
  const TurningPoint& from = turns[n - 1];
  const bool rises = n % 2 == 1;
  const double m = 2.0 / kappa;
  const double g = apart(e, largest);
  if (g <= 0.0) return {from.value + 1.0, 0.0};  // e_m, to rounding
  const double left = std::pow(rises ? g / from.apart : from.apart / g, m);
  return {rises ? from.value + 1.0 - left : from.value - 1.0 + left, m * left / g};
}

LawValue FeltReturnPoint::force(double e, double, const LawMemory& memory, LawStates&) const {
  if (e <= 0.0) return {};
  const double largest = memory.largest;
  if (e >= largest || largest < nothing) {
    const CurveValue load = envelope->loading(e);
    return {load.force, load.slope, 0.0};
  }
  const CycleStart* kept = memory.cycle;
  const bool known = kept != nullptr && kept->of == envelope.get() && kept->largest == largest;
  const CycleValue v =
      known ? envelope->cycle(e, *kept) : envelope->cycle(e, envelope->cycle_to(largest));
  const TurningPoints& turns = turns_of(memory);
  const auto [y, slope] = position(e, largest, turns, left_at(e, turns));
  const double mix = v.ratio + y * (1.0 - v.ratio);
  return {v.loading * mix,
          v.loading_slope * mix +
              v.loading * ((1.0 - y) * v.ratio_slope + (1.0 - v.ratio) * slope * v.loading),
          0.0};
}

/// Integral of y_f D from 0 to e [J], n turning points left.
double FeltReturnPoint::band_energy(double e, double largest, const TurningPoints& turns,
                                    std::size_t n) const {
  if (n == 0) return 0.0;
  TurningPoint top = turns[n - 1];
  const TurningPoint& low = n % 2 == 1 ? turns[n - 1] : turns[n - 2];
  if (n % 2 == 1) top = {e, apart(e, largest), position(e, largest, turns, n).force, 0.0};
  const double m = 2.0 / kappa;
  return low.below + integrate_band(*envelope, low.compression, e, largest, std::max(m, kOfEnergy),
                                    [&](double apart) {
                                      return top.value - 1.0 + std::pow(top.apart / apart, m);
                                    });
}

double FeltReturnPoint::energy(double e, const LawMemory& memory) const {
  if (e <= 0.0) return 0.0;
  const double largest = memory.largest;
  if (e >= largest || largest < nothing) return envelope->unloading_energy(e, e);
  const TurningPoints& turns = turns_of(memory);
  return envelope->unloading_energy(e, largest) + band_energy(e, largest, turns, left_at(e, turns));
}

double FeltReturnPoint::dissipated_power(double e, double rate, const LawMemory& memory) const {
  if (e <= 0.0) return 0.0;
  const double largest = memory.largest;
  if (e > largest || (e == largest && rate > 0.0)) return envelope->loop_area(e).slope * rate;
  const TurningPoints& turns = turns_of(memory);
  const std::size_t n = left_at(e, turns);
  if (n % 2 == 0) return 0.0;
  const TurningPoint& low = turns[n - 1];
  const double m = 2.0 / kappa;
  const double g = apart(e, largest);
  if (g <= 0.0) return 0.0;
  const double least = std::pow(g / low.apart, m);
  const double lost = integrate_band(*envelope, low.compression, e, largest, 0.5 * m,
                                     [&](double apart) { return std::pow(g / apart, m) - least; });
  return rate * m * envelope->loading(e).force / g * lost;
}

int FeltReturnPoint::piece(double e, double, const LawMemory& memory) const {
  if (e <= 0.0) return kOff;
  if (e >= memory.largest) return kLoading;
  return kUnloading + 8 * static_cast<int>(left_at(e, turns_of(memory)));
}

void FeltReturnPoint::turn(double e, double largest, TurningPoints& turns) const {
  if (e >= largest || largest < nothing) {
    turns.clear();
    return;
  }
  if (e <= 0.0) {
    turns.assign(1, {0.0, apart(0.0, largest), 0.0, 0.0});
    return;
  }
  std::size_t n = left_at(e, turns);
  if (n > 0 && turns[n - 1].compression == e) --n;  // a loop of no size
  TurningPoint at{e, apart(e, largest), position(e, largest, turns, n).force, 0.0};
  if (n % 2 == 0) at.below = band_energy(e, largest, turns, n);
  turns.resize(n);
  // G is zero to rounding: e_m itself.
  if (at.apart > 0.0) turns.push_back(at);
}

bool FeltReturnPoint::advance(PathPoint& at, double compression, double) const {
  const double from = at.compression;
  const bool virgin = from >= at.largest;
  if (compression < from && virgin) at.largest = std::max(0.0, from);
  if (compression != from && !virgin && (compression > from) != (at.turns.size() % 2 == 1)) {
    turn(from, at.largest, at.turns);
  }
  at.compression = compression;
  at.turns.resize(left_at(compression, at.turns));
  if (compression <= 0.0) turn(0.0, at.largest, at.turns);
  if (compression >= at.largest) {
    at.largest = std::max(0.0, compression);
    at.turns.clear();
  }
  return true;
}

}  // namespace feltmb
