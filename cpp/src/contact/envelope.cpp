#include "feltmb/contact/envelope.hpp"

#include <algorithm>
#include <cmath>

#include "feltmb/core/error.hpp"
#include "feltmb/numeric/bracketing.hpp"
#include "feltmb/numeric/quadrature.hpp"
#include "monotone_table.hpp"

namespace feltmb {
namespace {

using tables::kKnots;
using tables::knot_positions;
using tables::look_up;

constexpr double kLargest = 0.02;         // m, no felt of a machine is pressed further
constexpr double kAreaReach = 4.0;        // the tables over e_m go to this times e_M
constexpr std::size_t kShareRows = 128;   // of the energy share, over e_m
constexpr std::size_t kShareKnots = 128;  // over x
constexpr double kSmallest = 1e-12;       // of x, for roots

/// Three nodes are exact for a cubic of s times s.
const QuadratureRule& cell_rule() {
  static const QuadratureRule& rule = *new QuadratureRule(make_gauss_legendre(3));
  return rule;
}

}  // namespace

/// Loops meet at their end: rho raised by (1 - rho(1)) x^8, held in [0, 1].
std::vector<double> Envelope::close(std::vector<double> rho) const {
  const double rest = 1.0 - rho.back();
  const auto n = static_cast<double>(rho.size() - 1);
  for (std::size_t i = 0; i < rho.size(); ++i) {
    const double s = static_cast<double>(i) / n;
    rho[i] = std::clamp(rho[i] + rest * std::pow(s, 16), 0.0, 1.0);
  }
  return rho;
}

void Envelope::tabulate_ratio(std::vector<double> rho) {
  const std::vector<double> s = knot_positions();
  rho = close(std::move(rho));
  std::vector<double> weight(s.size());
  double most = 0.0;
  for (std::size_t i = 0; i < s.size(); ++i) {
    weight[i] = loading(s[i] * s[i] * closing_).force * s[i];
    most = std::max(most, weight[i]);
  }
  for (double& w : weight) w += 1e-9 * most;
  rho_ = tables::never_falling(rho, weight);
  rho_.back() = 1.0;
  for (std::size_t i = 0; i < s.size(); ++i) {
    const double e = s[i] * s[i] * closing_;
    const double change = std::fabs(rho_[i] - rho[i]) * loading(e).force;
    if (change <= 1e-12 * loading(closing_).force) continue;
    if (repair_.high == 0.0) repair_.low = e;
    repair_.high = e;
    repair_.force = std::max(repair_.force, change);
  }
  rho_slope_ = tables::monotone_slopes(s, rho_);
  rho_pieces_ = tables::pieces_of(rho_, rho_slope_);
}

void Envelope::tabulate_loading(const std::function<double(double)>& force, double reach,
                                bool smooth) {
  exponential_ = false;
  reach_ = reach;
  const std::vector<double> s = knot_positions();
  load_.resize(s.size());
  double before = 0.0;
  for (std::size_t i = 0; i < s.size(); ++i) {
    load_[i] = before = std::max(before, force(s[i] * s[i] * reach));
  }
  load_slope_ = smooth ? tables::smooth_slopes(load_) : tables::monotone_slopes(s, load_);
  load_pieces_ = tables::pieces_of(load_, load_slope_);
  load_energy_.assign(s.size(), 0.0);
  for (std::size_t i = 1; i < s.size(); ++i) {
    load_energy_[i] =
        load_energy_[i - 1] +
        integrate_rule(
            cell_rule(),
            [&](double t) { return look_up(load_pieces_.data(), t).force * 2.0 * t * reach_; },
            s[i - 1], s[i]);
  }
}

/// W(e_m) and its slope by quadrature; sqrt-spaced panels meet the kink of a curve that is held at
/// zero near e = 0. The slope is that of one shape of the cycle, stretched:
/// dW/de_m = integral of F_L(x e_m) rho'(x) x dx.
CurveValue Envelope::area_by_quadrature(double e_m) const {
  const auto integrate = [&](auto&& of) {
    return integrate_composite([&](double t) { return of(t * t) * 2.0 * t; }, 0.0, 1.0, 16);
  };
  return {integrate(
              [&](double x) { return loading(x * e_m).force * (1.0 - ratio(x, e_m).force) * e_m; }),
          integrate([&](double x) { return loading(x * e_m).force * ratio(x, e_m).slope * x; })};
}

void Envelope::tabulate_area() {
  const std::vector<double> s = knot_positions();
  area_.assign(s.size(), 0.0);
  area_slope_.assign(s.size(), 0.0);
  for (std::size_t i = 1; i < s.size(); ++i) {
    const CurveValue area = area_by_quadrature(s[i] * s[i] * area_reach_);
    area_[i] = area.force;
    area_slope_[i] = area.slope * 2.0 * s[i] * area_reach_;
  }
  if (rows_ > 1) area_slope_ = tables::smooth_slopes(area_);
}

/// Share of the loading energy that the unloading branch gives back up to x e_m: smooth, so that
/// a coarse table does for every cycle.
void Envelope::tabulate_energy() {
  const std::size_t width = kShareKnots + 1;
  const QuadratureRule narrow = make_gauss_legendre(5);
  share_.assign(kShareRows * width, 1.0);
  share_slope_.assign(kShareRows * width, 0.0);
  const std::vector<double> s = knot_positions(kShareKnots);
  for (std::size_t j = 0; j < kShareRows; ++j) {
    const double sigma =
        std::max(static_cast<double>(j), 0.1) / static_cast<double>(kShareRows - 1);
    const double e_m = sigma * sigma * area_reach_;
    double given = 0.0;
    for (std::size_t i = 0; i < width; ++i) {
      if (i > 0) {
        given += integrate_rule(
            narrow,
            [&](double t) {
              const double x = t * t;
              return loading(x * e_m).force * ratio(x, e_m).force * 2.0 * t * e_m;
            },
            s[i - 1], s[i]);
      }
      const double x = s[i] * s[i];
      const CurveValue load = loading(x * e_m);
      const double energy = loading_energy(x * e_m);
      const double rho = ratio(x, e_m).force;
      double& share = share_[j * width + i];
      if (i == 0 || !(energy > 0.0) || given <= 0.0) {
        share = rho;
        continue;
      }
      share = given / energy;
      share_slope_[j * width + i] = (rho - share) * load.force / energy * 2.0 * s[i] * e_m;
    }
    // Where nothing is stored yet the share is that of the first compression that does.
    for (std::size_t i = width - 1; i-- > 0;) {
      if (!(loading_energy(s[i] * s[i] * e_m) > 0.0)) {
        share_[j * width + i] = share_[j * width + i + 1];
      }
    }
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
  out->area_reach_ = kAreaReach * closing;
  const std::vector<double> s = knot_positions();
  std::vector<double> rho(s.size());
  for (std::size_t i = 0; i < s.size(); ++i) {
    // At e = 0 the ratio is that of the slopes.
    const double e = std::max(s[i] * s[i], 1e-9) * closing;
    const double f_load = evaluate(load, e).force;
    const double f_unload = evaluate(unload, e).force;
    rho[i] = f_load > 0.0 ? std::clamp(f_unload / f_load, 0.0, 1.0) : 1.0;
  }
  out->tabulate_ratio(std::move(rho));
  out->tabulate_area();
  out->tabulate_energy();
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
  out->closing_ = compression.back();
  out->area_reach_ = kAreaReach * out->closing_;
  const tables::Spline loading_spline(compression, load);
  const tables::Spline unloading_spline(compression, unload);
  out->tabulate_loading(loading_spline, out->closing_, false);
  const std::vector<double> s = knot_positions();
  std::vector<double> rho(s.size(), 1.0);
  for (std::size_t i = 0; i < s.size(); ++i) {
    const double e = s[i] * s[i] * out->closing_;
    if (out->load_[i] > 0.0) {
      rho[i] = std::clamp(std::max(0.0, unloading_spline(e)) / out->load_[i], 0.0, 1.0);
    }
  }
  rho[0] = rho[1];
  out->tabulate_ratio(std::move(rho));
  out->tabulate_area();
  out->tabulate_energy();
  return out;
}

std::shared_ptr<const Envelope> Envelope::from_shape(const EnvelopeShape& shape) {
  if (!(std::isfinite(shape.closing) && shape.closing > 0.0 && std::isfinite(shape.reach) &&
        shape.reach >= shape.closing && (shape.rows == 1 || shape.rows >= 4))) {
    throw InvalidParameter(
        format("envelope: closing = %.6g m, reach = %.6g m, rows = %d; must be 0 < closing <= "
               "reach, 1 row or >= 4",
               shape.closing, shape.reach, shape.rows));
  }
  std::shared_ptr<Envelope> out(new Envelope());
  out->closing_ = shape.closing;
  out->area_reach_ = std::max(kAreaReach * shape.closing, shape.reach);
  out->tabulate_loading(shape.loading, shape.reach, true);
  if (!(out->load_.back() > 0.0) || !std::isfinite(out->load_.back())) {
    throw InvalidParameter(
        format("envelope: loading force %.6g N at %.6g m, must be finite and > 0",
               out->load_.back(), shape.reach));
  }
  const std::vector<double> s = knot_positions();
  out->rows_ = static_cast<std::size_t>(shape.rows);
  if (shape.rows == 1) {
    std::vector<double> rho(s.size());
    for (std::size_t i = 0; i < s.size(); ++i) {
      rho[i] = shape.ratio(std::max(s[i] * s[i], kSmallest), shape.closing);
    }
    out->tabulate_ratio(std::move(rho));
  } else {
    for (std::size_t j = 0; j < out->rows_; ++j) {
      const double sigma = std::max(static_cast<double>(j), 0.1) / (shape.rows - 1.0);
      std::vector<double> row(s.size());
      for (std::size_t i = 0; i < s.size(); ++i) {
        row[i] = shape.ratio(std::max(s[i] * s[i], 1e-6), sigma * sigma * shape.reach);
      }
      row = out->close(std::move(row));
      const std::vector<double> slope = tables::monotone_slopes(s, row);
      out->rho_.insert(out->rho_.end(), row.begin(), row.end());
      out->rho_slope_.insert(out->rho_slope_.end(), slope.begin(), slope.end());
    }
  }
  out->tabulate_area();
  out->tabulate_energy();
  return out;
}

CurveValue Envelope::loading(double e) const {
  if (e <= first_positive_) return {0.0, 0.0};
  if (exponential_) return evaluate(curve_, e);
  if (e >= reach_) {
    const double slope = load_slope_.back() / (2.0 * reach_);
    return {load_.back() + slope * (e - reach_), slope};
  }
  const double s = std::sqrt(e / reach_);
  const CurveValue v = look_up(load_pieces_.data(), s);
  return {v.force, v.slope / (2.0 * s * reach_)};
}

/// Weights of a quadratic B-spline over the rows of rho at e_m: smooth, positive, of sum 1.
void Envelope::blend_rows(double e_m, CycleStart& to) const {
  if (rows_ == 1) return;
  const double p = std::sqrt(std::min(e_m / reach_, 1.0)) * static_cast<double>(rows_ - 1);
  const auto middle = std::min(static_cast<std::size_t>(std::lround(p)), rows_ - 1);
  const double f = p - static_cast<double>(middle);
  to.row[0] = middle > 0 ? middle - 1 : 0;
  to.row[1] = middle;
  to.row[2] = std::min(middle + 1, rows_ - 1);
  to.weight[0] = 0.5 * (0.5 - f) * (0.5 - f);
  to.weight[1] = 0.75 - f * f;
  to.weight[2] = 0.5 * (0.5 + f) * (0.5 + f);
}

/// rho and its slope by s = sqrt(x).
CurveValue Envelope::ratio_of_root(double s, const CycleStart& to) const {
  if (rows_ == 1) return look_up(rho_pieces_.data(), s);
  const double position = s * static_cast<double>(kKnots);
  const std::size_t i = std::min(static_cast<std::size_t>(position), kKnots - 1);
  return tables::evaluate(blended_piece(i, to), tables::kWidth, position - static_cast<double>(i));
}

/// The rows are blended first: one cubic instead of three.
CubicPiece Envelope::blended_piece(std::size_t i, const CycleStart& to) const {
  double v[4] = {};
  for (std::size_t k = 0; k < 3; ++k) {
    const double w = to.weight[k];
    const double* value = rho_.data() + to.row[k] * (kKnots + 1) + i;
    const double* slope = rho_slope_.data() + to.row[k] * (kKnots + 1) + i;
    v[0] += w * value[0];
    v[1] += w * value[1];
    v[2] += w * slope[0];
    v[3] += w * slope[1];
  }
  return tables::piece_between(v[0], v[1], v[2], v[3], tables::kWidth);
}

CurveValue Envelope::ratio(double x, double e_m) const {
  if (x >= 1.0) return {1.0, 0.0};
  const double s = std::sqrt(std::max(x, kSmallest));
  CycleStart to;
  blend_rows(e_m, to);
  const CurveValue v = ratio_of_root(s, to);
  return {v.force, v.slope / (2.0 * s)};
}

CycleStart Envelope::cycle_to(double e_m) const {
  CycleStart to;
  to.of = this;
  to.largest = e_m;
  to.area = e_m > area_reach_
                ? area_by_quadrature(e_m).force
                : look_up(area_.data(), area_slope_.data(), std::sqrt(e_m / area_reach_)).force;
  blend_rows(e_m, to);
  return to;
}

CycleValue Envelope::cycle(double e, const CycleStart& to) const {
  CycleValue c;
  const CurveValue load = loading(e);
  c.loading = load.force;
  c.loading_slope = load.slope;
  const double s = std::sqrt(std::max(e / to.largest, kSmallest));
  const CurveValue rho = ratio_of_root(s, to);
  c.ratio = rho.force;
  c.ratio_slope = rho.slope / (2.0 * s * to.largest);
  c.area = to.area;
  return c;
}

double Envelope::loading_energy(double e) const {
  if (e <= first_positive_) return 0.0;
  if (exponential_) return integral(curve_, e) - energy_offset_;
  if (e >= reach_) {
    const double slope = load_slope_.back() / (2.0 * reach_);
    const double beyond = e - reach_;
    return load_energy_.back() + beyond * (load_.back() + 0.5 * slope * beyond);
  }
  const double s = std::sqrt(e / reach_);
  const auto i = std::min(static_cast<std::size_t>(s * static_cast<double>(kKnots)), kKnots - 1);
  const double from = static_cast<double>(i) / static_cast<double>(kKnots);
  return load_energy_[i] +
         integrate_rule(
             cell_rule(),
             [&](double t) { return look_up(load_pieces_.data(), t).force * 2.0 * t * reach_; },
             from, s);
}

CurveValue Envelope::loop_area(double e_m) const {
  if (e_m <= 0.0) return {0.0, 0.0};
  if (e_m > area_reach_) return area_by_quadrature(e_m);  // rare: no felt is pressed that far
  const double s = std::sqrt(e_m / area_reach_);
  const CurveValue v = look_up(area_.data(), area_slope_.data(), s);
  return {v.force, v.slope / (2.0 * s * area_reach_)};
}

double Envelope::unloading_energy(double e, double e_m) const {
  if (e <= 0.0 || e_m <= 0.0) return 0.0;
  const double whole = loading_energy(e);
  // At the top the loop's own area, so that energy and loss are of one table.
  if (e >= e_m) return whole - loop_area(e_m).force;
  if (e_m > area_reach_) {
    return integrate_composite(
        [&](double u) {
          const double x = u * u * e / e_m;
          return loading(x * e_m).force * ratio(x, e_m).force * 2.0 * u * e;
        },
        0.0, 1.0, 16);
  }
  constexpr std::size_t width = kShareKnots + 1;
  const double s = std::sqrt(e / e_m) * static_cast<double>(kShareKnots);
  const auto i = std::min(static_cast<std::size_t>(s), kShareKnots - 1);
  const double u = s - static_cast<double>(i);
  const auto at_row = [&](std::size_t row) {
    const double* v = share_.data() + row * width + i;
    const double* m = share_slope_.data() + row * width + i;
    return tables::hermite(v[0], v[1], m[0], m[1], 1.0 / static_cast<double>(kShareKnots), u).force;
  };
  // Four rows around e_m, interpolated by the cubic through them.
  const double p = std::sqrt(std::min(e_m / area_reach_, 1.0)) * (kShareRows - 1.0);
  const auto first = static_cast<std::size_t>(
      std::clamp(std::floor(p) - 1.0, 0.0, static_cast<double>(kShareRows - 4)));
  const double t = p - static_cast<double>(first);
  const double share = -at_row(first) * (t - 1.0) * (t - 2.0) * (t - 3.0) / 6.0 +
                       at_row(first + 1) * t * (t - 2.0) * (t - 3.0) / 2.0 -
                       at_row(first + 2) * t * (t - 1.0) * (t - 3.0) / 2.0 +
                       at_row(first + 3) * t * (t - 1.0) * (t - 2.0) / 6.0;
  return whole * share;
}

}  // namespace feltmb
