#include "monotone_table.hpp"

#include <algorithm>
#include <cmath>

namespace feltmb::tables {

std::vector<double> knot_positions(std::size_t n) {
  std::vector<double> s(n + 1);
  for (std::size_t i = 0; i <= n; ++i) s[i] = static_cast<double>(i) / static_cast<double>(n);
  return s;
}

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

std::vector<double> smooth_slopes(const std::vector<double>& v) {
  const std::size_t n = v.size();
  const double per_h = static_cast<double>(n - 1);
  std::vector<double> slope(n);
  const auto secant = [&](std::size_t i) { return (v[i + 1] - v[i]) * per_h; };
  for (std::size_t i = 0; i < n; ++i) {
    double m = 0.0;
    if (i >= 2 && i + 2 < n) {
      m = (8.0 * (v[i + 1] - v[i - 1]) - (v[i + 2] - v[i - 2])) * per_h / 12.0;
    } else if (i < 2) {
      // Five points from this end; the formulas of fourth order.
      m = i == 0 ? (-25.0 * v[0] + 48.0 * v[1] - 36.0 * v[2] + 16.0 * v[3] - 3.0 * v[4])
                 : (-3.0 * v[0] - 10.0 * v[1] + 18.0 * v[2] - 6.0 * v[3] + v[4]);
      m *= per_h / 12.0;
    } else {
      const double* w = v.data() + n - 1;
      m = i == n - 1 ? (25.0 * w[0] - 48.0 * w[-1] + 36.0 * w[-2] - 16.0 * w[-3] + 3.0 * w[-4])
                     : (3.0 * w[0] + 10.0 * w[-1] - 18.0 * w[-2] + 6.0 * w[-3] - w[-4]);
      m *= per_h / 12.0;
    }
    const double left = secant(i > 0 ? i - 1 : 0);
    const double right = secant(i + 1 < n ? i : n - 2);
    if (left * right <= 0.0) {
      m = 0.0;
    } else {
      const double most = 3.0 * std::min(std::fabs(left), std::fabs(right));
      m = std::copysign(std::clamp(m * std::copysign(1.0, left), 0.0, most), left);
    }
    slope[i] = m;
  }
  return slope;
}

std::vector<CubicPiece> pieces_of(const std::vector<double>& value,
                                  const std::vector<double>& slope) {
  std::vector<CubicPiece> out(value.size() - 1);
  for (std::size_t i = 0; i < out.size(); ++i) {
    out[i] = piece_between(value[i], value[i + 1], slope[i], slope[i + 1], kWidth);
  }
  return out;
}

std::vector<double> never_falling(const std::vector<double>& value,
                                  const std::vector<double>& weight) {
  struct Block {
    double sum, weight;
    std::size_t count;
    double mean() const { return sum / weight; }
  };
  std::vector<Block> blocks;
  for (std::size_t i = 0; i < value.size(); ++i) {
    blocks.push_back({value[i] * weight[i], weight[i], 1});
    while (blocks.size() > 1 && blocks[blocks.size() - 2].mean() > blocks.back().mean()) {
      const Block last = blocks.back();
      blocks.pop_back();
      blocks.back().sum += last.sum;
      blocks.back().weight += last.weight;
      blocks.back().count += last.count;
    }
  }
  std::vector<double> out;
  out.reserve(value.size());
  for (const Block& block : blocks) out.insert(out.end(), block.count, block.mean());
  return out;
}

Spline::Spline(const std::vector<double>& at, const std::vector<double>& value)
    : t(at), v(value), m(monotone_slopes(at, value)) {}

double Spline::operator()(double x) const {
  const auto it = std::upper_bound(t.begin(), t.end(), x);
  std::size_t i = it == t.begin() ? 0 : static_cast<std::size_t>(it - t.begin()) - 1;
  if (i + 1 >= t.size()) i = t.size() - 2;
  const double h = t[i + 1] - t[i];
  return hermite(v[i], v[i + 1], m[i], m[i + 1], h, (x - t[i]) / h).force;
}

}  // namespace feltmb::tables
