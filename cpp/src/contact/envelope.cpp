#include "feltmb/contact/envelope.hpp"

#include <algorithm>
#include <cmath>

#include "feltmb/core/error.hpp"
#include "feltmb/numeric/bracketing.hpp"
#include "feltmb/numeric/quadrature.hpp"

namespace feltmb {
namespace {

constexpr std::size_t kKnots = 256;  // intervals of a table
constexpr double kLargest = 0.02;    // m, no felt of a machine is pressed further
constexpr double kAreaReach = 4.0;   // the table of loop areas goes to this times e_M

/// Fritsch-Butland slopes of a monotone cubic through (t, v).
std::vector<double> monotone_slopes(const std::vector<double>& t, const std::vector<double>& v) {
  const std::size_t n = t.size();
  std::vector<double> slope(n, 0.0);
  const auto secant = [&](std::size_t i) { return (v[i + 1] - v[i]) / (t[i + 1] - t[i]); };
  for (std::size_t i = 1; i + 1 < n; ++i) {
    const double a = secant(i - 1);
    const double b = secant(i);
    if (a * b <= 0.0) continue;
    const double h0 = t[i] - t[i - 1];
    const double h1 = t[i + 1] - t[i];
    const double w0 = 2.0 * h1 + h0;
    const double w1 = h1 + 2.0 * h0;
    slope[i] = (w0 + w1) / (w0 / a + w1 / b);
  }
  if (n > 1) {
    // One-sided ends, held monotone.
    const auto end = [&](double near, double far, double h0, double h1) {
      double s = ((2.0 * h0 + h1) * near - h0 * far) / (h0 + h1);
      if (s * near <= 0.0)
        s = 0.0;
      else if (near * far <= 0.0 && std::fabs(s) > 3.0 * std::fabs(near))
        s = 3.0 * near;
      return s;
    };
    if (n == 2) {
      slope[0] = slope[1] = secant(0);
    } else {
      slope[0] = end(secant(0), secant(1), t[1] - t[0], t[2] - t[1]);
      slope[n - 1] = end(secant(n - 2), secant(n - 3), t[n - 1] - t[n - 2], t[n - 2] - t[n - 3]);
    }
  }
  return slope;
}

CurveValue hermite(double v0, double v1, double m0, double m1, double h, double u) {
  const double d = (v1 - v0) / h;
  const double c2 = 3.0 * d - 2.0 * m0 - m1;
  const double c3 = m0 + m1 - 2.0 * d;
  return {v0 + u * h * (m0 + u * (c2 + u * c3)), m0 + u * (2.0 * c2 + 3.0 * u * c3)};
}

/// Value and slope by s of an equally spaced table over s in [0, 1].
CurveValue look_up(const std::vector<double>& value, const std::vector<double>& slope, double s) {
  const double position = s * static_cast<double>(kKnots);
  auto i = static_cast<std::size_t>(position);
  if (i >= kKnots) i = kKnots - 1;
  const double u = position - static_cast<double>(i);
  return hermite(value[i], value[i + 1], slope[i], slope[i + 1], 1.0 / static_cast<double>(kKnots),
                 u);
}

std::vector<double> knot_positions() {
  std::vector<double> s(kKnots + 1);
  for (std::size_t i = 0; i <= kKnots; ++i) {
    s[i] = static_cast<double>(i) / static_cast<double>(kKnots);
  }
  return s;
}

/// Monotone cubic through a user's table.
struct Spline {
  std::vector<double> t, v, m;
  Spline(const std::vector<double>& time, const std::vector<double>& value)
      : t(time), v(value), m(monotone_slopes(time, value)) {}
  double operator()(double x) const {
    const auto it = std::upper_bound(t.begin(), t.end(), x);
    std::size_t i = it == t.begin() ? 0 : static_cast<std::size_t>(it - t.begin()) - 1;
    if (i + 1 >= t.size()) i = t.size() - 2;
    const double h = t[i + 1] - t[i];
    return hermite(v[i], v[i + 1], m[i], m[i + 1], h, (x - t[i]) / h).force;
  }
};

}  // namespace

void Envelope::tabulate_ratio(const std::vector<double>& s, std::vector<double> rho) {
  const double rest = 1.0 - rho.back();
  for (std::size_t i = 0; i < rho.size(); ++i) {
    const double x = s[i] * s[i];
    rho[i] = std::clamp(rho[i] + rest * std::pow(x, 8), 0.0, 1.0);
  }
  rho_ = std::move(rho);
  rho_slope_ = monotone_slopes(s, rho_);
}

void Envelope::tabulate_area() {
  const std::vector<double> s = knot_positions();
  area_.assign(s.size(), 0.0);
  area_slope_.assign(s.size(), 0.0);
  const double reach = kAreaReach * closing_;
  for (std::size_t i = 1; i < s.size(); ++i) {
    const double e_m = s[i] * s[i] * reach;
    // sqrt-spaced panels meet the kink of a curve that is held at zero near e = 0.
    area_[i] = integrate_composite(
        [&](double t) {
          const double x = t * t;
          return loading(x * e_m).force * (1.0 - ratio(x).force) * 2.0 * t * e_m;
        },
        0.0, 1.0, 16);
    // dW/de_m = integral of F_L(x e_m) rho'(x) x dx, from the stretch of the cycle's shape.
    const double slope = integrate_composite(
        [&](double t) {
          const double x = t * t;
          return loading(x * e_m).force * ratio(x).slope * x * 2.0 * t;
        },
        0.0, 1.0, 16);
    area_slope_[i] = slope * 2.0 * s[i] * reach;
  }
}

std::shared_ptr<const Envelope> Envelope::from_curves(const ExponentialCurve& load,
                                                      const ExponentialCurve& unload,
                                                      double closing) {
  std::shared_ptr<Envelope> out(new Envelope());
  out->curve_ = load;
  if (load.a + load.c < 0.0 && load.a > 0.0 && load.b > 0.0) {
    out->first_positive_ = std::log(-load.c / load.a) / load.b;
  }
  out->energy_offset_ = integral(load, out->first_positive_);
  const auto band = [&](double e) { return evaluate(load, e).force - evaluate(unload, e).force; };
  if (closing == 0.0) {
    // The last crossing from above: the fits may also cross near zero, which is their fault.
    double previous = 0.0;
    bool above = false;
    constexpr int steps = 4000;
    for (int i = 1; i <= steps; ++i) {
      const double e = kLargest * i / steps;
      const double value = band(e);
      if (above && value <= 0.0) {
        closing = find_root_bracketed(band, previous, band(previous), e, value - 1e-300, 1e-12);
        break;
      }
      above = value > 0.0 && e > out->first_positive_;
      previous = e;
    }
    if (closing == 0.0) {
      throw InvalidParameter(
          "felt_memory: loading and unloading curves do not meet below 20 mm; give "
          "closing_compression, the largest compression of the measured loop");
    }
  }
  if (!(std::isfinite(closing) && closing > out->first_positive_ && closing < 1.0)) {
    throw InvalidParameter(
        format("felt_memory: closing_compression = %.6g m, must be > 0 and "
               "beyond the compression where the loading force is zero",
               closing));
  }
  out->closing_ = closing;
  const std::vector<double> s = knot_positions();
  std::vector<double> rho(s.size());
  for (std::size_t i = 0; i < s.size(); ++i) {
    // At e = 0 the ratio is that of the slopes.
    const double e = std::max(s[i] * s[i], 1e-9) * closing;
    const double f_load = evaluate(load, e).force;
    const double f_unload = evaluate(unload, e).force;
    rho[i] = f_load > 0.0 ? std::clamp(f_unload / f_load, 0.0, 1.0) : 1.0;
  }
  out->tabulate_ratio(s, std::move(rho));
  out->tabulate_area();
  return out;
}

std::shared_ptr<const Envelope> Envelope::from_table(const std::vector<double>& compression,
                                                     const std::vector<double>& load,
                                                     const std::vector<double>& unload) {
  const std::size_t n = compression.size();
  if (n < 3 || load.size() != n || unload.size() != n) {
    throw InvalidParameter(
        format("felt_memory: envelope table has %zu compressions, %zu loading "
               "and %zu unloading forces; expected equal and >= 3",
               n, load.size(), unload.size()));
  }
  for (std::size_t i = 0; i < n; ++i) {
    if (!std::isfinite(compression[i]) || !std::isfinite(load[i]) || !std::isfinite(unload[i])) {
      throw InvalidParameter(format("felt_memory: envelope row %zu is not finite", i));
    }
    if (i > 0 && !(compression[i] > compression[i - 1] && load[i] >= load[i - 1])) {
      throw InvalidParameter(
          format("felt_memory: envelope row %zu: compression must grow and the "
                 "loading force must not fall",
                 i));
    }
    if (unload[i] > load[i] * (1.0 + 1e-9) + 1e-12) {
      throw InvalidParameter(
          format("felt_memory: envelope row %zu: unloading force %.6g N above "
                 "loading force %.6g N",
                 i, unload[i], load[i]));
    }
  }
  if (compression[0] != 0.0 || load[0] != 0.0) {
    throw InvalidParameter("felt_memory: envelope must begin at compression 0 with force 0");
  }
  std::shared_ptr<Envelope> out(new Envelope());
  out->exponential_ = false;
  out->closing_ = compression.back();
  const Spline loading_spline(compression, load);
  const Spline unloading_spline(compression, unload);
  const std::vector<double> s = knot_positions();
  std::vector<double> rho(s.size(), 1.0);
  out->load_.resize(s.size());
  for (std::size_t i = 0; i < s.size(); ++i) {
    const double e = s[i] * s[i] * out->closing_;
    out->load_[i] = std::max(0.0, loading_spline(e));
    if (out->load_[i] > 0.0) {
      rho[i] = std::clamp(std::max(0.0, unloading_spline(e)) / out->load_[i], 0.0, 1.0);
    }
  }
  rho[0] = rho[1];
  out->load_slope_ = monotone_slopes(s, out->load_);
  out->load_energy_.assign(s.size(), 0.0);
  for (std::size_t i = 1; i < s.size(); ++i) {
    out->load_energy_[i] =
        out->load_energy_[i - 1] +
        integrate_rule(
            gauss16(),
            [&](double t) {
              return out->loading(t * t * out->closing_).force * 2.0 * t * out->closing_;
            },
            s[i - 1], s[i]);
  }
  out->tabulate_ratio(s, std::move(rho));
  out->tabulate_area();
  return out;
}

CurveValue Envelope::loading(double e) const {
  if (e <= first_positive_) return {0.0, 0.0};
  if (exponential_) return evaluate(curve_, e);
  if (e >= closing_) {
    const double slope = load_slope_.back() / (2.0 * closing_);
    return {load_.back() + slope * (e - closing_), slope};
  }
  const double s = std::sqrt(e / closing_);
  const CurveValue v = look_up(load_, load_slope_, s);
  return {v.force, v.slope / (2.0 * s * closing_)};
}

CurveValue Envelope::ratio(double x) const {
  if (x >= 1.0) return {1.0, 0.0};
  const double s = std::sqrt(std::max(x, 1e-12));
  const CurveValue v = look_up(rho_, rho_slope_, s);
  return {v.force, v.slope / (2.0 * s)};
}

double Envelope::loading_energy(double e) const {
  if (e <= first_positive_) return 0.0;
  if (exponential_) return integral(curve_, e) - energy_offset_;
  if (e >= closing_) {
    const double slope = load_slope_.back() / (2.0 * closing_);
    const double beyond = e - closing_;
    return load_energy_.back() + beyond * (load_.back() + 0.5 * slope * beyond);
  }
  const double s = std::sqrt(e / closing_) * static_cast<double>(kKnots);
  const auto i = std::min(static_cast<std::size_t>(s), kKnots - 1);
  const double from = static_cast<double>(i) / static_cast<double>(kKnots);
  return load_energy_[i] +
         integrate_rule(
             gauss16(),
             [&](double t) { return loading(t * t * closing_).force * 2.0 * t * closing_; }, from,
             std::sqrt(e / closing_));
}

CurveValue Envelope::loop_area(double e_m) const {
  if (e_m <= 0.0) return {0.0, 0.0};
  const double reach = kAreaReach * closing_;
  if (e_m > reach) {
    const double slope = area_slope_.back() / (2.0 * reach);
    return {area_.back() + slope * (e_m - reach), slope};
  }
  const double s = std::sqrt(e_m / reach);
  const CurveValue v = look_up(area_, area_slope_, s);
  return {v.force, v.slope / (2.0 * s * reach)};
}

double Envelope::unloading_energy(double e, double e_m) const {
  if (e <= 0.0 || e_m <= 0.0) return 0.0;
  const double end = std::min(e, e_m);
  double sum = integrate_composite(
      [&](double t) {
        const double x = t * t * end;
        return loading(x).force * ratio(x / e_m).force * 2.0 * t * end;
      },
      0.0, 1.0, 8);
  if (e > e_m) sum += loading_energy(e) - loading_energy(e_m);
  return sum;
}

}  // namespace feltmb
