#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "feltmb/fiber/faults.hpp"
#include "feltmb/fiber/orientation.hpp"
#include "feltmb/numeric/constants.hpp"
#include "feltmb/numeric/floor_within.hpp"
#include "feltmb/numeric/parallel.hpp"
#include "feltmb/numeric/random.hpp"
#include "symmetric_tensor.hpp"

namespace feltmb {
namespace {

/// Points of a sphere sorted into cubic cells; neighbors within one cell side are in 27 cells.
class SphereCells {
 public:
  SphereCells(const Directions& points, double side)
      : count_(std::max(1, static_cast<int>(2.2 / side))) {
    const auto n = static_cast<std::size_t>(points.rows());
    cell_of_.resize(n);
    start_.assign(static_cast<std::size_t>(count_) * static_cast<std::size_t>(count_) *
                          static_cast<std::size_t>(count_) +
                      1,
                  0);
    for (std::size_t i = 0; i < n; ++i) {
      cell_of_[i] = cell(points.row(static_cast<Eigen::Index>(i)));
      ++start_[cell_of_[i] + 1];
    }
    for (std::size_t c = 1; c < start_.size(); ++c) start_[c] += start_[c - 1];
    members_.resize(n);
    std::vector<std::size_t> next(start_.begin(), start_.end() - 1);
    for (std::size_t i = 0; i < n; ++i) members_[next[cell_of_[i]]++] = i;
  }

  template <class Visit>
  void visit(const Eigen::RowVector3d& point, Visit&& visit_one) const {
    const int x = coordinate(point[0]);
    const int y = coordinate(point[1]);
    const int z = coordinate(point[2]);
    for (int i = std::max(0, x - 1); i <= std::min(count_ - 1, x + 1); ++i) {
      for (int j = std::max(0, y - 1); j <= std::min(count_ - 1, y + 1); ++j) {
        for (int k = std::max(0, z - 1); k <= std::min(count_ - 1, z + 1); ++k) {
          const std::size_t c = index(i, j, k);
          for (std::size_t m = start_[c]; m < start_[c + 1]; ++m) visit_one(members_[m]);
        }
      }
    }
  }

 private:
  [[nodiscard]] int coordinate(double x) const {
    return floor_within((x + 1.1) / 2.2 * count_, 0, count_ - 1);
  }
  [[nodiscard]] std::size_t index(int i, int j, int k) const {
    return static_cast<std::size_t>((i * count_ + j) * count_ + k);
  }
  [[nodiscard]] std::size_t cell(const Eigen::RowVector3d& point) const {
    return index(coordinate(point[0]), coordinate(point[1]), coordinate(point[2]));
  }
  int count_;
  std::vector<std::size_t> cell_of_, start_, members_;
};

void check_directions(const Eigen::Ref<const Directions>& directions, double limit) {
  Faults faults("network");
  const auto n = static_cast<double>(directions.rows());
  if (!(n >= 2.0 && n <= limit)) {
    faults.add("number of fibers", n, "", format("between 2 and %.0f", limit),
               "pair sums take n^2 work");
  }
  for (Eigen::Index i = 0; i < directions.rows(); ++i) {
    const double length = directions.row(i).norm();
    if (!(std::abs(length - 1.0) < 1e-9)) {
      faults.add(format("|direction %ld|", static_cast<long>(i)).c_str(), length, "",
                 "1 (a unit vector)");
      break;
    }
  }
  faults.raise_if_any();
}

}  // namespace

Eigen::VectorXd affine_density(const Eigen::Matrix3d& deformation,
                               const Eigen::Ref<const Directions>& directions) {
  const double determinant = deformation.determinant();
  if (!(determinant > 0.0) || !std::isfinite(determinant)) {
    throw InvalidParameter(
        format("deformation gradient: det F = %.6g, must be finite and > 0", determinant));
  }
  const Eigen::Matrix3d inverse = deformation.inverse();
  Eigen::VectorXd result(directions.rows());
  for (Eigen::Index i = 0; i < directions.rows(); ++i) {
    const Eigen::Vector3d before = inverse * directions.row(i).transpose();
    const double length = before.norm();
    result[i] = 1.0 / (4.0 * kPi * determinant * length * length * length);
  }
  return result;
}

Directions make_random_directions(std::size_t n, std::uint64_t seed, std::size_t spread,
                                  std::size_t threads) {
  Faults faults("network");
  faults.within("n", static_cast<double>(n), 2, 1e6, "fibers");
  faults.within("spread", static_cast<double>(spread), 0, 10000, "steps");
  faults.raise_if_any();
  Random random(seed);
  Directions points(static_cast<Eigen::Index>(n), 3);
  for (Eigen::Index i = 0; i < points.rows();) {
    const Eigen::RowVector3d point(random.uniform(-1.0, 1.0), random.uniform(-1.0, 1.0),
                                   random.uniform(-1.0, 1.0));
    const double length = point.norm();
    // Very short vectors are rejected too: their direction is lost to rounding.
    if (length > 1.0 || length < 1e-6) continue;
    points.row(i++) = point / length;
  }
  const double spacing = std::sqrt(2.0 * kPi / static_cast<double>(n));
  const double reach = std::min(2.5 * spacing, 1.0);
  for (std::size_t step = 0; step < spread; ++step) {
    // Large steps even out the long waves, small ones at the end the nearest neighbors.
    const double reduced = 1.0 - static_cast<double>(step) / static_cast<double>(spread);
    const double amount = spacing * (0.02 + 0.98 * reduced * reduced);
    Directions axes(2 * points.rows(), 3);
    axes << points, -points;
    const SphereCells cells(axes, reach);
    Directions moved(points.rows(), 3);
    parallel_for(n, threads, [&](std::size_t begin, std::size_t end) {
      for (std::size_t i = begin; i < end; ++i) {
        const Eigen::RowVector3d point = points.row(static_cast<Eigen::Index>(i));
        Eigen::RowVector3d push = Eigen::RowVector3d::Zero();
        cells.visit(point, [&](std::size_t j) {
          if (j == i) return;
          const Eigen::RowVector3d away = point - axes.row(static_cast<Eigen::Index>(j));
          const double distance = away.norm();
          if (distance < reach && distance > 0.0) {
            const double gap = 1.0 - distance / reach;
            push += away * (gap * gap / distance);
          }
        });
        push -= point * point.dot(push);
        moved.row(static_cast<Eigen::Index>(i)) = (point + amount * push).normalized();
      }
    });
    points = moved;
  }
  return points;
}

Directions deform_directions(const Eigen::Ref<const Directions>& directions,
                             const Eigen::Matrix3d& deformation) {
  const double determinant = deformation.determinant();
  if (!(determinant > 0.0) || !std::isfinite(determinant)) {
    throw InvalidParameter(
        format("deformation gradient: det F = %.6g, must be finite and > 0", determinant));
  }
  Directions result = directions * deformation.transpose();
  result.rowwise().normalize();
  return result;
}

SampledStructure estimate_structure(const Eigen::Ref<const Directions>& directions,
                                    std::size_t threads) {
  check_directions(directions, 2e5);
  const Eigen::Index n = directions.rows();
  const auto count = static_cast<double>(n);
  // Columns: sums over j of w, w n3^4, w (e3_i^4 + e3_j^4)/2 and of their squares and products.
  Eigen::Matrix<double, Eigen::Dynamic, 8, Eigen::RowMajor> sums(n, 8);
  const Eigen::VectorXd fourth = directions.col(2).array().square().square();
  parallel_for(static_cast<std::size_t>(n), threads, [&](std::size_t begin, std::size_t end) {
    for (auto i = static_cast<Eigen::Index>(begin); i < static_cast<Eigen::Index>(end); ++i) {
      const double x = directions(i, 0);
      const double y = directions(i, 1);
      const double z = directions(i, 2);
      double s[8] = {0, 0, 0, 0, 0, 0, 0, 0};
      for (Eigen::Index j = 0; j < n; ++j) {
        const double a = y * directions(j, 2) - z * directions(j, 1);
        const double b = z * directions(j, 0) - x * directions(j, 2);
        const double c = x * directions(j, 1) - y * directions(j, 0);
        const double square = a * a + b * b + c * c;
        if (j == i || square == 0.0) continue;
        const double w = std::sqrt(square);
        const double wn = c * c * c * c / (square * w);
        const double we = w * 0.5 * (fourth[i] + fourth[j]);
        s[0] += w;
        s[1] += wn;
        s[2] += we;
        s[3] += w * w;
        s[4] += wn * wn;
        s[5] += we * we;
        s[6] += w * wn;
        s[7] += w * we;
      }
      for (int column = 0; column < 8; ++column) sums(i, column) = s[column];
    }
  });
  sums /= count - 1.0;
  const Eigen::Matrix<double, 1, 8> mean = sums.colwise().mean();
  // Variance of a pair average: 4 z1 / n + 2 z2 / n^2, with z1 the variance of the per-fiber mean
  // (which itself is inflated by z2 / n) and z2 that of the kernel.
  const auto error = [&](const Eigen::VectorXd& per_fiber, double kernel_variance) {
    const double spread = (per_fiber.array() - per_fiber.mean()).square().sum() / (count - 1.0);
    const double second = std::max(0.0, kernel_variance);
    const double first = std::max(0.0, spread - second / count);
    return std::sqrt(4.0 * first / count + 2.0 * second / (count * count));
  };
  SampledStructure result{};
  const double f = mean[0];
  const double n3 = mean[1] / f;
  const double e3 = mean[2] / f;
  result.f = {f, error(sums.col(0), mean[3] - f * f)};
  result.n3 = {n3, error((sums.col(1) - n3 * sums.col(0)) / f,
                         (mean[4] - 2.0 * n3 * mean[6] + n3 * n3 * mean[3]) / (f * f))};
  result.e3 = {e3, error((sums.col(2) - e3 * sums.col(0)) / f,
                         (mean[5] - 2.0 * e3 * mean[7] + e3 * e3 * mean[3]) / (f * f))};
  const auto plain = [&](const Eigen::ArrayXd& values) {
    const double average = values.mean();
    return Estimate{average, std::sqrt((values - average).square().sum() / (count - 1.0) / count)};
  };
  result.K3 = plain(directions.col(2).array().abs());
  result.M3 = plain(1.0 - directions.col(2).array().square());
  return result;
}

FiberStructure estimate_tensors(const Eigen::Ref<const Directions>& directions,
                                std::size_t threads) {
  check_directions(directions, 2e5);
  const Eigen::Index n = directions.rows();
  FiberStructure result;
  SymmetricTensor4 fiber4;
  for (Eigen::Index i = 0; i < n; ++i) {
    const Eigen::Vector3d e = directions.row(i).transpose();
    fiber4.add(e, 1.0 / static_cast<double>(n));
    result.ee += e * e.transpose() / static_cast<double>(n);
    result.K3 += std::abs(e[2]) / static_cast<double>(n);
  }
  result.M3 = 1.0 - result.ee(2, 2);
  struct Sums {
    SymmetricTensor4 normal, axis, transverse;
    double weight = 0.0;
  };
  // One partial sum per fiber block of fixed size: the same for every thread count.
  constexpr Eigen::Index kBlock = 64;
  const auto blocks = static_cast<std::size_t>((n + kBlock - 1) / kBlock);
  std::vector<Sums> partial(blocks);
  parallel_for(blocks, threads, [&](std::size_t begin, std::size_t end) {
    for (std::size_t block = begin; block < end; ++block) {
      Sums& sums = partial[block];
      const Eigen::Index first = static_cast<Eigen::Index>(block) * kBlock;
      for (Eigen::Index i = first; i < std::min(n, first + kBlock); ++i) {
        const Eigen::Vector3d e = directions.row(i).transpose();
        for (Eigen::Index j = 0; j < n; ++j) {
          if (j == i) continue;
          const Eigen::Vector3d cross = e.cross(Eigen::Vector3d(directions.row(j)));
          const double w = cross.norm();
          if (w == 0.0) continue;
          const Eigen::Vector3d normal = cross / w;
          sums.weight += w;
          if (j > i) sums.normal.add(normal, 2.0 * w);
          sums.axis.add(e, w);
          sums.transverse.add(normal.cross(e), w);
        }
      }
    }
  });
  Sums total;
  for (const Sums& sums : partial) {
    total.weight += sums.weight;
    total.normal.add(sums.normal, 1.0);
    total.axis.add(sums.axis, 1.0);
    total.transverse.add(sums.transverse, 1.0);
  }
  total.normal.scale(1.0 / total.weight);
  total.axis.scale(1.0 / total.weight);
  total.transverse.scale(1.0 / total.weight);
  result.f = total.weight / (static_cast<double>(n) * static_cast<double>(n - 1));
  result.eeee = fiber4.full();
  result.nnnn_contact = total.normal.full();
  result.eeee_contact = total.axis.full();
  result.tttt_contact = total.transverse.full();
  result.n3 = component(result.nnnn_contact, 2, 2, 2, 2);
  result.e3 = component(result.eeee_contact, 2, 2, 2, 2);
  result.obstruction = std::numeric_limits<double>::quiet_NaN();
  return result;
}

}  // namespace feltmb
