#include "feltmb/fiber/carnaby_pan.hpp"

#include <algorithm>
#include <cmath>

#include "feltmb/core/error.hpp"
#include "feltmb/fiber/faults.hpp"
#include "feltmb/numeric/bracketing.hpp"
#include "feltmb/numeric/constants.hpp"
#include "feltmb/numeric/quadrature.hpp"

namespace feltmb {
namespace {

double free_length(const SlidingNetwork& network, double v) {
  return network.gamma * network.d_f / -std::expm1(-network.Q * network.gamma * v);
}

/// Mean sin^2 theta at R (closed form, series near R = 1).
double mean_square_sine(double ratio) {
  const double x = ratio - 1.0;
  if (std::fabs(x) < 1e-2) {
    // Powers of x up to the fifth: exact value of <cos^2>, expanded about R = 1.
    const double cos2 =
        1.0 / 3.0 +
        x * (-4.0 / 15.0 +
             x * (6.0 / 35.0 +
                  x * (-32.0 / 315.0 +
                       x * (40.0 / 693.0 + x * (-32.0 / 1001.0 + x * (112.0 / 6435.0))))));
    return 1.0 - cos2;
  }
  const double q = ratio * ratio - 1.0;
  const double cos2 = ratio * std::acosh(ratio) / (q * std::sqrt(q)) - 1.0 / q;
  return 1.0 - cos2;
}

/// State of dimensionless contact force q = C / (Wf0 lambda).
struct Cap {
  double theta = 0.0;
  double r = 0.0;
  double elastic = 0.0;  // (1 - r) q
  double loading = 0.0;  // r C_s / (Wf0 lambda)
  double unloading = 0.0;
};

Cap cap_at(double ratio, double mu, double q) {
  Cap cap;
  if (q <= 1.0) {
    cap.elastic = q;
    return cap;
  }
  cap.theta = critical_angle(1.0 / q, mu);
  cap.r = sliding_proportion(ratio, cap.theta);
  const double s = std::sin(cap.theta);
  const double c = std::cos(cap.theta);
  // 1 - r without the cancellation that 1.0 - cap.r has at large q.
  cap.elastic = ratio * c / std::sqrt(s * s + ratio * ratio * c * c) * q;
  cap.loading = sliding_resistance(ratio, mu, cap.theta);
  cap.unloading = sliding_resistance(ratio, 0.0, cap.theta);
  return cap;
}

/// Dimensionless pressure, with no more integrals than it needs.
double pressure_at(double ratio, double mu, double q, Stress kind) {
  if (q <= 1.0) return q;
  const double theta = critical_angle(1.0 / q, mu);
  const double s = std::sin(theta);
  const double c = std::cos(theta);
  const double elastic = ratio * c / std::sqrt(s * s + ratio * ratio * c * c) * q;
  if (kind == Stress::loading) return elastic + sliding_resistance(ratio, mu, theta);
  if (kind == Stress::unloading) return elastic - sliding_resistance(ratio, 0.0, theta);
  return elastic;
}

/// Slope of the dimensionless unloading pressure by the critical angle.
double unloading_slope(double ratio, double mu, double theta) {
  const double s = std::sin(theta);
  const double c = std::cos(theta);
  const double q = 1.0 / (c - mu * s);
  const double d2 = s * s + ratio * ratio * c * c;
  const double d = std::sqrt(d2);
  return ratio * (c / d * q * q * (s + mu * c) - s / (d2 * d) * (q + 1.0 / c));
}

double force_at(double mu, double theta) { return 1.0 / (std::cos(theta) - mu * std::sin(theta)); }

/// Where the unloading pressure turns, if it does: contact forces q of its maximum and of the
/// minimum after it.
struct Turning {
  bool monotone = true;
  double q_max = 1.0;
  double q_min = 1.0;
};

Turning find_turning(double ratio, double mu) {
  constexpr int steps = 256;
  const double limit = std::atan2(1.0, mu);
  const auto slope = [&](double theta) { return unloading_slope(ratio, mu, theta); };
  const auto root = [&](double a, double b) {
    const double fa = slope(a);
    const double fb = slope(b);
    if (fa == 0.0) return a;
    if (fb == 0.0) return b;
    return find_root_bracketed(slope, a, fa, b, fb, 1e-13);
  };
  Turning out;
  double before = 0.0;
  bool rising = true;
  for (int i = 1; i < steps; ++i) {
    const double theta = limit * i / steps;
    const bool now = slope(theta) > 0.0;
    if (rising && !now) {
      out.monotone = false;
      out.q_max = slope(before) > 0.0 ? force_at(mu, root(before, theta)) : 1.0;
    }
    if (!rising && now) out.q_min = force_at(mu, root(before, theta));
    rising = now;
    before = theta;
  }
  return out;
}

double contacts_per_area(const SlidingNetwork& network, double v) {
  return 2.0 * v / (kPi * network.d_f * network.d_f) / (1.0 + v / network.v_f0);
}

Sliding dimensional(const SlidingNetwork& network, double v, double q, const Cap& cap) {
  const double unit = network.Wf0 * free_length(network, v);
  const double stress = contacts_per_area(network, v) * unit;
  Sliding out;
  out.C = q * unit;
  out.theta_cr = cap.theta;
  out.r_sc = cap.r;
  out.C_s_loading = cap.r > 0.0 ? cap.loading / cap.r * unit : unit;
  out.C_s_unloading = cap.r > 0.0 ? cap.unloading / cap.r * unit : unit;
  out.sigma = cap.elastic * stress;
  out.tau_loading = cap.loading * stress;
  out.tau_unloading = cap.unloading * stress;
  return out;
}

/// dC/dv [N].
double force_rate(const SlidingNetwork& network, double bending, double v) {
  const double ratio = v / network.v_f0;
  const double lambda = free_length(network, v);
  return bending / ((1.0 + ratio) * mean_square_sine(ratio) * lambda * lambda * v);
}

void fill(const SlidingNetwork& network, FrictionForm form, CarnabyPanLoop& loop) {
  const std::size_t n = loop.v_f.size();
  for (auto* column : {&loop.theta_cr, &loop.r_sc, &loop.C_s_loading, &loop.C_s_unloading,
                       &loop.sigma_el, &loop.P_loading, &loop.P_unloading}) {
    column->resize(n);
  }
  for (std::size_t i = 0; i < n; ++i) {
    const Sliding s = sliding_at_force(network, loop.v_f[i], loop.C[i]);
    loop.theta_cr[i] = s.theta_cr;
    loop.r_sc[i] = s.r_sc;
    loop.C_s_loading[i] = s.C_s_loading;
    loop.C_s_unloading[i] = s.C_s_unloading;
    loop.sigma_el[i] = s.sigma;
    loop.P_loading[i] = s.sigma + s.tau_loading;
    loop.P_unloading[i] = s.sigma - s.tau_unloading;
  }
  if (form == FrictionForm::repaired || n == 0) return;
  std::vector<double> stick(n), slide(n);
  for (std::size_t i = 0; i < n; ++i) {
    // One cap instead of two, and an integral instead of an average.
    loop.C_s_loading[i] *= 0.5 * loop.r_sc[i];
    loop.C_s_unloading[i] *= 0.5 * loop.r_sc[i];
    loop.r_sc[i] *= 0.5;
    const double contacts = contacts_per_area(network, loop.v_f[i]);
    stick[i] = (1.0 - loop.r_sc[i]) * contacts;
    slide[i] = loop.r_sc[i] * contacts;
  }
  // The march starts at v_f0 without load, which need not be the first point asked for.
  loop.sigma_el[0] = stick[0] * loop.C[0];
  loop.P_loading[0] = loop.sigma_el[0] + slide[0] * loop.C_s_loading[0];
  for (std::size_t i = 1; i < n; ++i) {
    const double weight = 0.5 * (stick[i] + stick[i - 1]);
    const double part = weight * (loop.C[i] - loop.C[i - 1]);
    loop.sigma_el[i] = loop.sigma_el[i - 1] + part;
    loop.P_loading[i] =
        loop.P_loading[i - 1] + part +
        0.5 * (slide[i] + slide[i - 1]) * (loop.C_s_loading[i] - loop.C_s_loading[i - 1]);
  }
  loop.P_unloading[n - 1] = loop.P_loading[n - 1];
  for (std::size_t i = n - 1; i-- > 0;) {
    loop.P_unloading[i] =
        loop.P_unloading[i + 1] - 0.5 * (stick[i] + stick[i + 1]) * (loop.C[i + 1] - loop.C[i]) +
        0.5 * (slide[i] + slide[i + 1]) * (loop.C_s_unloading[i + 1] - loop.C_s_unloading[i]);
  }
}

double bending_constant(const SlidingNetwork& network, double E, double k_bend, const char* where) {
  validate(network, where);
  Faults faults(where);
  faults.positive("E", E, "Pa");
  faults.positive("k_bend", k_bend, "", "24 for clamped ends");
  faults.raise_if_any();
  return k_bend * E * kPi * std::pow(network.d_f, 4) / 64.0;
}

}  // namespace

void validate(const SlidingNetwork& network, const char* where) {
  Faults faults(where);
  faults.not_negative("mu", network.mu, "");
  faults.positive("Wf0", network.Wf0, "N/m");
  faults.positive("d_f", network.d_f, "m");
  if (!(network.v_f0 > 0.0 && network.v_f0 < 1.0)) {
    faults.add("v_f0", network.v_f0, "", "> 0 and < 1");
  }
  faults.positive("gamma", network.gamma, "");
  faults.positive("Q", network.Q, "");
  faults.raise_if_any();
}

double critical_angle(double w, double mu) {
  if (!(w < 1.0)) return 0.0;
  // The + root of eq. 3.66 in the form without cancellation at w -> 1.
  const double root = std::sqrt(1.0 + mu * mu - w * w);
  const double sine = (1.0 - w) * (1.0 + w) / (mu * w + root);
  return std::atan2(sine, w + mu * sine);
}

double sliding_proportion(double ratio, double theta) {
  const double s = std::sin(theta);
  const double c = ratio * std::cos(theta);
  const double root = std::sqrt(s * s + c * c);
  return s * s / (root * (root + c));
}

double sliding_resistance(double ratio, double mu, double theta) {
  if (theta <= 0.0) return 0.0;
  const double s = std::sin(theta);
  const double c = std::cos(theta);
  const double u = (s / c) * (s / c);
  if (mu == 0.0 && u > 1e-2 && u < 1e6) {
    const double a = std::sqrt(1.0 + u);
    const double b = std::sqrt(u + ratio * ratio);
    return ratio * (std::log((a + b) / (1.0 + ratio)) - a / b + 1.0 / ratio);
  }
  // x = tan(theta), p = log((1 + x) / (1 - mu x)): bounded and smooth for every mu.
  const double end = std::log((c + s) / (c - mu * s));
  const auto integrand = [&](double p) {
    const double x = std::expm1(p) / (1.0 + mu * std::exp(p));
    const double q = x * x + ratio * ratio;
    return x * std::sqrt(1.0 + x * x) * (1.0 + x) / (q * std::sqrt(q));
  };
  const auto panels = static_cast<std::size_t>(std::ceil(end / 0.75));
  return ratio / (1.0 + mu) *
         integrate_composite(integrand, 0.0, end, std::max<std::size_t>(panels, 1));
}

Sliding sliding_at_force(const SlidingNetwork& network, double v_f, double C) {
  const double q = C / (network.Wf0 * free_length(network, v_f));
  return dimensional(network, v_f, q, cap_at(v_f / network.v_f0, network.mu, q));
}

bool unloading_is_unique(double ratio, double mu) { return find_turning(ratio, mu).monotone; }

Sliding sliding_at_pressure(const SlidingNetwork& network, double v_f, double pressure, Stress kind,
                            bool* unique) {
  const double ratio = v_f / network.v_f0;
  const double mu = network.mu;
  const double unit = contacts_per_area(network, v_f) * network.Wf0 * free_length(network, v_f);
  const double target = pressure / unit;
  const auto excess = [&](double q) { return pressure_at(ratio, mu, q, kind) - target; };
  if (unique != nullptr) *unique = true;
  const auto solve = [&](double low, double high) {
    const double f_low = excess(low);
    const double f_high = excess(high);
    if (!(f_low < 0.0)) return low;
    if (!(f_high > 0.0)) return high;
    return find_root_bracketed(excess, low, f_low, high, f_high, 1e-15 * high);
  };
  const auto solve_above = [&](double low) {
    double high = 2.0 * std::max(low, target);
    while (excess(high) < 0.0) {
      high *= 4.0;
      if (high > 1e15) {
        throw InvalidParameter(
            format("friction: no contact force gives %.6g Pa at v_f = %.6g with mu = %.6g: without "
                   "friction between the fibers the stress of the sticking contacts is bounded",
                   pressure, v_f, mu));
      }
    }
    return solve(low, high);
  };
  double q = target;
  Turning turning;
  if (kind == Stress::unloading) turning = find_turning(ratio, mu);
  if (!turning.monotone) {
    const double lowest = pressure_at(ratio, mu, turning.q_min, kind);
    const double highest = pressure_at(ratio, mu, turning.q_max, kind);
    if (target >= lowest) {
      q = solve_above(turning.q_min);
      if (unique != nullptr) *unique = target > highest;
    } else if (target > 1.0) {
      q = solve(1.0, turning.q_max);
    }
  } else if (target > 1.0) {
    q = solve_above(1.0);
  }
  return dimensional(network, v_f, q, cap_at(ratio, mu, q));
}

CarnabyPanLoop carnaby_pan(const SlidingNetwork& network, double E, double k_bend,
                           std::span<const double> v_f, FrictionForm form) {
  const double bending = bending_constant(network, E, k_bend, "carnaby_pan");
  Faults faults("carnaby_pan");
  for (std::size_t i = 0; i < v_f.size() && !faults.any(); ++i) {
    if (!(v_f[i] >= network.v_f0 && v_f[i] < 1.0)) {
      faults.add_text(
          format("v_f[%zu] = %.6g, must be from v_f0 = %.6g to below 1", i, v_f[i], network.v_f0));
    } else if (i > 0 && !(v_f[i] > v_f[i - 1])) {
      faults.add_text(
          format("v_f[%zu] = %.6g after %.6g, must grow (both branches are given at "
                 "each v_f)",
                 i, v_f[i], v_f[i - 1]));
    }
  }
  faults.raise_if_any();
  CarnabyPanLoop loop;
  loop.v_f.assign(v_f.begin(), v_f.end());
  loop.C.resize(v_f.size());
  double from = network.v_f0;
  double force = 0.0;
  for (std::size_t i = 0; i < v_f.size(); ++i) {
    const auto panels = static_cast<std::size_t>(std::ceil((v_f[i] - from) / 0.05)) + 1;
    force += integrate_composite([&](double v) { return force_rate(network, bending, v); }, from,
                                 v_f[i], panels);
    loop.C[i] = force;
    from = v_f[i];
  }
  fill(network, form, loop);
  return loop;
}

CarnabyPanLoop carnaby_pan_march(const SlidingNetwork& network, double E, double k_bend,
                                 std::span<const double> C, int substeps, FrictionForm form) {
  const double bending = bending_constant(network, E, k_bend, "carnaby_pan_march");
  Faults faults("carnaby_pan_march");
  if (substeps < 1) faults.add("substeps", substeps, "", ">= 1");
  for (std::size_t i = 0; i < C.size() && !faults.any(); ++i) {
    if (!(std::isfinite(C[i]) && C[i] >= (i == 0 ? 0.0 : C[i - 1]))) {
      faults.add_text(format("C[%zu] = %.6g N, must be finite, >= 0 and growing", i, C[i]));
    }
  }
  faults.raise_if_any();
  CarnabyPanLoop loop;
  loop.C.assign(C.begin(), C.end());
  loop.v_f.resize(C.size());
  double v = network.v_f0;
  double force = 0.0;
  const auto rate = [&](double at) { return 1.0 / force_rate(network, bending, at); };
  for (std::size_t i = 0; i < C.size(); ++i) {
    const double h = (C[i] - force) / substeps;
    for (int k = 0; k < substeps; ++k) {
      const double k1 = rate(v);
      const double k2 = rate(v + 0.5 * h * k1);
      const double k3 = rate(v + 0.5 * h * k2);
      const double k4 = rate(v + h * k3);
      v += h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4);
    }
    force = C[i];
    if (!(v < 1.0)) {
      throw InvalidParameter(format(
          "carnaby_pan_march: C[%zu] = %.6g N leads to v_f = %.6g, must stay below 1", i, C[i], v));
    }
    loop.v_f[i] = v;
  }
  fill(network, form, loop);
  return loop;
}

}  // namespace feltmb
