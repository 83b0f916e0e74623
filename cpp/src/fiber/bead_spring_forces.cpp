#include <algorithm>
#include <array>
#include <cmath>

#include "bead_spring_box.hpp"
#include "feltmb/core/error.hpp"
#include "feltmb/numeric/floor_within.hpp"

namespace feltmb {
namespace {

using namespace bead_spring;

/// Nearest points of two segments x1 + s u, x2 + t w, s, t in [0, 1].
struct Nearest {
  double s, t;
  Vec gap;  ///< from the second to the first
};

Nearest nearest_points(const Vec& u, const Vec& w, const Vec& between) {
  // between = x1 - x2. Standard clamped solution of the 2 x 2 normal equations.
  const double a = u.squaredNorm();
  const double e = w.squaredNorm();
  const double b = u.dot(w);
  const double c = u.dot(between);
  const double f = w.dot(between);
  const double determinant = a * e - b * b;
  double s =
      determinant > 1e-12 * a * e ? std::clamp((b * f - c * e) / determinant, 0.0, 1.0) : 0.5;
  double t = (b * s + f) / e;
  if (t < 0.0) {
    t = 0.0;
    s = std::clamp(-c / a, 0.0, 1.0);
  } else if (t > 1.0) {
    t = 1.0;
    s = std::clamp((b - c) / a, 0.0, 1.0);
  }
  return {s, t, between + s * u - t * w};
}

}  // namespace

void BeadSpringNetwork::Implementation::make_list() {
  const double far = 0.5 * shortest_side();
  for (int k = 0; k < 3; ++k) {
    if (box[k] < shortest_side()) {
      throw ModelError(
          format("bead-spring network: box side %d = %.6g m at v_f = %.6g, must be "
                 ">= %.6g m (start from more fibers or a lower v_f)",
                 k + 1, box[k], fraction(), shortest_side()));
    }
  }
  std::array<int, 3> count{};
  for (int k = 0; k < 3; ++k) {
    count[static_cast<std::size_t>(k)] = floor_within(box[k] / far, 1, 200);
  }
  const auto cells = static_cast<std::size_t>(count[0] * count[1] * count[2]);
  std::vector<std::size_t> start(cells + 1, 0);
  std::vector<std::size_t> cell_of(beads);
  const auto is_segment = [&](std::size_t i) { return i % p.n_beads + 1 < p.n_beads; };
  std::vector<std::array<int, 3>> place(beads);
  for (std::size_t i = 0; i < beads; ++i) {
    if (!is_segment(i)) continue;
    const Vec middle = 0.5 * (x[i] + x[i + 1]);
    for (std::size_t k = 0; k < 3; ++k) {
      const double part = middle[static_cast<Eigen::Index>(k)] / box[static_cast<Eigen::Index>(k)];
      place[i][k] = floor_within((part - std::floor(part)) * count[k], 0, count[k] - 1);
    }
    cell_of[i] =
        static_cast<std::size_t>((place[i][0] * count[1] + place[i][1]) * count[2] + place[i][2]);
    ++start[cell_of[i] + 1];
  }
  for (std::size_t c = 1; c <= cells; ++c) start[c] += start[c - 1];
  std::vector<std::size_t> member(start[cells]);
  std::vector<std::size_t> next(start.begin(), start.end() - 1);
  for (std::size_t i = 0; i < beads; ++i) {
    if (is_segment(i)) member[next[cell_of[i]]++] = i;
  }
  std::vector<std::vector<std::int64_t>> found(beads);
  team.run(beads, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      if (!is_segment(i)) continue;
      const Vec u = x[i + 1] - x[i];
      // With fewer than three cells on a side each is visited once.
      std::array<std::array<int, 3>, 3> visit{};
      std::array<int, 3> visits{};
      for (std::size_t k = 0; k < 3; ++k) {
        visits[k] = std::min(3, count[k]);
        for (int o = 0; o < visits[k]; ++o) {
          visit[k][static_cast<std::size_t>(o)] =
              visits[k] < 3 ? o : (place[i][k] + o - 1 + count[k]) % count[k];
        }
      }
      for (int a = 0; a < visits[0]; ++a) {
        for (int b = 0; b < visits[1]; ++b) {
          for (int c = 0; c < visits[2]; ++c) {
            const auto cell =
                static_cast<std::size_t>((visit[0][static_cast<std::size_t>(a)] * count[1] +
                                          visit[1][static_cast<std::size_t>(b)]) *
                                             count[2] +
                                         visit[2][static_cast<std::size_t>(c)]);
            for (std::size_t m = start[cell]; m < start[cell + 1]; ++m) {
              const std::size_t j = member[m];
              if (j <= i) continue;
              if (j / p.n_beads == i / p.n_beads && j - i < 2) continue;
              const Vec w = x[j + 1] - x[j];
              const Vec middles = nearest_image(x[i] + 0.5 * u - x[j] - 0.5 * w);
              if (middles.squaredNorm() > far * far) continue;
              const Nearest near = nearest_points(u, w, middles - 0.5 * u + 0.5 * w);
              if (near.gap.norm() < reach + skin) {
                found[i].push_back(static_cast<std::int64_t>(j));
              }
            }
          }
        }
      }
      std::sort(found[i].begin(), found[i].end());
    }
  });
  std::map<std::pair<std::int64_t, std::int64_t>, Vec> kept;
  for (std::size_t k = 0; k < pairs.size(); ++k) {
    if (spring[k].squaredNorm() > 0.0) kept[{pairs[k].a, pairs[k].b}] = spring[k];
  }
  pairs.clear();
  spring.clear();
  for (std::size_t i = 0; i < beads; ++i) {
    for (std::int64_t j : found[i]) {
      pairs.push_back({static_cast<std::int64_t>(i), j});
      const auto old = kept.find({static_cast<std::int64_t>(i), j});
      spring.push_back(old == kept.end() ? Vec(Vec::Zero()) : old->second);
    }
  }
  touch.assign(pairs.size(), Touch{});
  share_start.assign(beads + 1, 0);
  for (const Pair& pair : pairs) {
    ++share_start[static_cast<std::size_t>(pair.a) + 1];
    ++share_start[static_cast<std::size_t>(pair.b) + 1];
  }
  for (std::size_t i = 1; i <= beads; ++i) share_start[i] += share_start[i - 1];
  share.resize(2 * pairs.size());
  std::vector<std::size_t> fill(share_start.begin(), share_start.end() - 1);
  for (std::size_t k = 0; k < pairs.size(); ++k) {
    share[fill[static_cast<std::size_t>(pairs[k].a)]++] = k;
    share[fill[static_cast<std::size_t>(pairs[k].b)]++] = k;
  }
  x_listed = x;
  strain_listed = 0.0;
  listed = true;
}

void BeadSpringNetwork::Implementation::check_list() {
  if (listed) {
    double moved = 0.0;
    for (const FiberSums& sums : fiber_sums) moved = std::max(moved, sums.moved);
    // Two beads may approach by twice the movement; straining brings distant points nearer too.
    if (2.0 * std::sqrt(moved) + strain_listed * (p.segment_length + reach) < skin) return;
  }
  make_list();
}

std::pair<double, double> BeadSpringNetwork::Implementation::repel(double r) const {
  if (p.repulsion == Repulsion::hertz || soft) {
    const double depth = 1.0 - r / reach;
    if (depth <= 0.0) return {0.0, 0.0};
    const double scale = soft ? interaction / 20.0 : interaction;
    const double root = std::sqrt(depth);
    return {0.5 * scale * depth * depth * root, 1.25 * scale * depth * root / reach};
  }
  if (r >= reach * (1.0 - 1e-9)) return {0.0, 0.0};
  const double q = std::max(r, 1e-3 * reach);
  const double back = q - reach;
  const double fade = std::exp(q / back);
  const double log = std::log(q / reach);
  return {-interaction * log * fade, interaction * fade * (1.0 / q - log * reach / (back * back))};
}

void BeadSpringNetwork::Implementation::compute_forces(bool slide) {
  check_list();
  const bool rub = p.friction > 0.0 && !soft;
  team.run(pairs.size(), [&](std::size_t begin, std::size_t end) {
    for (std::size_t k = begin; k < end; ++k) {
      const auto a = static_cast<std::size_t>(pairs[k].a);
      const auto b = static_cast<std::size_t>(pairs[k].b);
      const Vec u = x[a + 1] - x[a];
      const Vec w = x[b + 1] - x[b];
      const Vec middles = nearest_image(x[a] + 0.5 * u - x[b] - 0.5 * w);
      const Nearest near = nearest_points(u, w, middles - 0.5 * u + 0.5 * w);
      Touch& result = touch[k];
      const double square = near.gap.squaredNorm();
      if (square >= reach * reach) {
        if (result.active || spring[k].squaredNorm() > 0.0) spring[k].setZero();
        result.active = false;
        continue;
      }
      const double r = std::sqrt(square);
      // Axes that cross exactly are parted along their common normal.
      const Vec normal = r > 1e-9 * reach ? Vec(near.gap / r) : Vec(u.cross(w).normalized());
      const auto [energy, push] = repel(r);
      result.active = true;
      result.s = near.s;
      result.t = near.t;
      result.gap = near.gap;
      result.distance = r;
      result.energy = energy;
      result.force = push * normal;
      result.tangential_energy = 0.0;
      result.friction_loss = 0.0;
      if (rub) {
        Vec& stretch_now = spring[k];
        // A restart computes forces without sliding: the spring must come back untouched.
        if (slide) {
          const Vec speed =
              (1.0 - near.s) * v[a] + near.s * v[a + 1] - (1.0 - near.t) * v[b] - near.t * v[b + 1];
          stretch_now += dt * speed;
          stretch_now -= normal * normal.dot(stretch_now);
          const double length = stretch_now.norm();
          const double limit = p.friction * push / tangential;
          if (length > limit) {
            stretch_now *= limit / length;
            result.friction_loss = tangential * limit * (length - limit);
          }
        }
        result.force -= tangential * stretch_now;
        result.tangential_energy = 0.5 * tangential * stretch_now.squaredNorm();
      }
    }
  });
  team.run(p.n_fibers, [&](std::size_t begin, std::size_t end) {
    for (std::size_t fiber = begin; fiber < end; ++fiber) fiber_forces(fiber);
  });
  virial.setZero();
  pair_energy = pair_tangential = 0.0;
  for (const FiberSums& sums : fiber_sums) virial += sums.virial;
  for (const Touch& result : touch) {
    if (!result.active) continue;
    virial += result.gap.cwiseProduct(result.force);
    pair_energy += result.energy;
    pair_tangential += result.tangential_energy;
    if (slide) friction_loss += result.friction_loss;
  }
}

void BeadSpringNetwork::Implementation::fiber_forces(std::size_t fiber) {
  FiberSums& sums = fiber_sums[fiber];
  sums = FiberSums{};
  const std::size_t first = fiber * p.n_beads;
  for (std::size_t i = first; i < first + p.n_beads; ++i) force[i].setZero();
  const double l = p.segment_length;
  for (std::size_t i = first; i + 1 < first + p.n_beads; ++i) {
    const Vec u = x[i + 1] - x[i];
    const double length = u.norm();
    const double strain = length / l - 1.0;
    sums.stretching += 0.5 * stretch * strain * strain;
    const Vec pull = stretch * strain / (l * length) * u;
    force[i] += pull;
    force[i + 1] -= pull;
    sums.virial -= u.cwiseProduct(pull);
    for (std::size_t m = share_start[i]; m < share_start[i + 1]; ++m) {
      const Touch& contact = touch[share[m]];
      if (!contact.active) continue;
      const bool is_a = static_cast<std::size_t>(pairs[share[m]].a) == i;
      const double place = is_a ? contact.s : contact.t;
      const Vec f = is_a ? contact.force : Vec(-contact.force);
      force[i] += (1.0 - place) * f;
      force[i + 1] += place * f;
    }
  }
  for (std::size_t i = first + 1; i + 1 < first + p.n_beads; ++i) {
    const Vec before = x[i] - x[i - 1];
    const Vec after = x[i + 1] - x[i];
    const double la = before.norm();
    const double lb = after.norm();
    const Vec ta = before / la;
    const Vec tb = after / lb;
    const double cosine = std::clamp(ta.dot(tb), -1.0, 1.0);
    const double sine = ta.cross(tb).norm();
    const double angle = std::atan2(sine, cosine);
    const double change = angle - rest[i];
    sums.bending += 0.5 * bend * change * change;
    // dE = K (phi - phi0) dphi, dphi = -d(cos)/sin; a straight, crimped joint has no direction.
    const double factor = bend * change / std::max(sine, 1e-6);
    const Vec on_next = factor * (ta - cosine * tb) / lb;
    const Vec on_last = -factor * (tb - cosine * ta) / la;
    force[i + 1] += on_next;
    force[i - 1] += on_last;
    force[i] -= on_next + on_last;
    sums.virial += after.cwiseProduct(on_next) - before.cwiseProduct(on_last);
  }
  for (std::size_t i = first; i < first + p.n_beads; ++i) {
    sums.max_force = std::max(sums.max_force, force[i].norm());
    sums.kinetic += 0.5 * mass * v[i].squaredNorm();
    sums.moved = std::max(sums.moved, (x[i] - x_listed[i]).squaredNorm());
  }
}

}  // namespace feltmb
