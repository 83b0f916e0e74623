#include "feltmb/numeric/elliptic.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace feltmb {

double carlson_rf(double x, double y, double z) {
  if (!(x >= 0.0 && y >= 0.0 && z >= 0.0) || (x == 0.0) + (y == 0.0) + (z == 0.0) > 1) {
    return std::numeric_limits<double>::quiet_NaN();
  }
  const double mean0 = (x + y + z) / 3.0;
  double mean = mean0;
  double spread = std::max({std::abs(mean0 - x), std::abs(mean0 - y), std::abs(mean0 - z)});
  // 400 = (3 * 1e-16)^(-1/6) rounded up: the series below is then exact to rounding.
  spread *= 400.0;
  double x0 = mean0 - x;
  double y0 = mean0 - y;
  double scale = 1.0;
  while (scale * spread >= std::abs(mean)) {
    const double root =
        std::sqrt(x) * std::sqrt(y) + std::sqrt(x) * std::sqrt(z) + std::sqrt(y) * std::sqrt(z);
    mean = 0.25 * (mean + root);
    x = 0.25 * (x + root);
    y = 0.25 * (y + root);
    z = 0.25 * (z + root);
    scale *= 0.25;
  }
  x0 *= scale / mean;
  y0 *= scale / mean;
  const double z0 = -x0 - y0;
  const double e2 = x0 * y0 - z0 * z0;
  const double e3 = x0 * y0 * z0;
  return (1.0 - e2 / 10.0 + e3 / 14.0 + e2 * e2 / 24.0 - 3.0 * e2 * e3 / 44.0) / std::sqrt(mean);
}

double carlson_rd(double x, double y, double z) {
  if (!(x >= 0.0 && y >= 0.0 && z > 0.0) || (x == 0.0 && y == 0.0)) {
    return std::numeric_limits<double>::quiet_NaN();
  }
  const double mean0 = (x + y + 3.0 * z) / 5.0;
  double mean = mean0;
  double spread = std::max({std::abs(mean0 - x), std::abs(mean0 - y), std::abs(mean0 - z)});
  spread *= 600.0;
  double x0 = mean0 - x;
  double y0 = mean0 - y;
  double scale = 1.0;
  double sum = 0.0;
  while (scale * spread >= std::abs(mean)) {
    const double root =
        std::sqrt(x) * std::sqrt(y) + std::sqrt(x) * std::sqrt(z) + std::sqrt(y) * std::sqrt(z);
    sum += scale / (std::sqrt(z) * (z + root));
    mean = 0.25 * (mean + root);
    x = 0.25 * (x + root);
    y = 0.25 * (y + root);
    z = 0.25 * (z + root);
    scale *= 0.25;
  }
  x0 *= scale / mean;
  y0 *= scale / mean;
  const double z0 = -(x0 + y0) / 3.0;
  const double e2 = x0 * y0 - 6.0 * z0 * z0;
  const double e3 = (3.0 * x0 * y0 - 8.0 * z0 * z0) * z0;
  const double e4 = 3.0 * (x0 * y0 - z0 * z0) * z0 * z0;
  const double e5 = x0 * y0 * z0 * z0 * z0;
  const double series = 1.0 - 3.0 * e2 / 14.0 + e3 / 6.0 + 9.0 * e2 * e2 / 88.0 - 3.0 * e4 / 22.0 -
                        9.0 * e2 * e3 / 52.0 + 3.0 * e5 / 26.0;
  return scale * series / (mean * std::sqrt(mean)) + 3.0 * sum;
}

}  // namespace feltmb
