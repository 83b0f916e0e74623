#include "feltmb/fiber/bead_spring.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <numbers>

#include "feltmb/fiber/faults.hpp"
#include "feltmb/numeric/floor_within.hpp"
#include "feltmb/numeric/parallel.hpp"
#include "feltmb/numeric/random.hpp"

namespace feltmb {
namespace {

constexpr double kPi = std::numbers::pi;
using Vec = Eigen::Vector3d;

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

struct Pair {
  std::int64_t a, b;  ///< segments, a < b, numbered fiber * n_beads + index of the first bead
};

/// Result of one pair in the present step.
struct Touch {
  bool active = false;
  double s = 0.0, t = 0.0;
  Vec force = Vec::Zero();  ///< on segment a
  Vec gap = Vec::Zero();
  double distance = 0.0;
  double energy = 0.0;
  double tangential_energy = 0.0;
  double friction_loss = 0.0;
};

/// Touching segments by (a, b).
using TouchingPairs = std::map<std::pair<std::int64_t, std::int64_t>, const Touch*>;

/// Whether no neighboring segment pair is nearer: a place where fibers touch may show in several.
/// Of equal distances (a shared bead) the earlier pair counts.
bool nearest_of_place(const TouchingPairs& near, const TouchingPairs::key_type& pair,
                      const Touch& here) {
  for (std::int64_t i = -1; i <= 1; ++i) {
    for (std::int64_t j = -1; j <= 1; ++j) {
      if (i == 0 && j == 0) continue;
      const TouchingPairs::key_type other{pair.first + i, pair.second + j};
      const auto found = near.find(other);
      if (found == near.end()) continue;
      const double distance = found->second->distance;
      if (distance < here.distance || (distance == here.distance && other < pair)) return false;
    }
  }
  return true;
}

}  // namespace

void validate(const BeadSpringParams& p) {
  Faults faults("bead-spring network");
  faults.within("n_fibers", static_cast<double>(p.n_fibers), 2, 1e5, "");
  faults.within("n_beads", static_cast<double>(p.n_beads), 2, 1e4, "");
  faults.positive("d_f", p.d_f, "m");
  if (!(p.segment_length >= p.d_f) || !std::isfinite(p.segment_length)) {
    faults.add("segment_length", p.segment_length, "m", format(">= d_f = %.6g m", p.d_f),
               "shorter segments overlap their next but one");
  }
  if (!(p.v_f > 0.0 && p.v_f < 0.5)) faults.add("v_f", p.v_f, "", "> 0 and < 0.5");
  faults.within("crimp", p.crimp, 0.0, 1.0, "rad");
  faults.within("ratio", p.ratio, 1e-2, 1e4, "");
  faults.positive("E", p.E, "Pa");
  faults.positive("density", p.density, "kg/m^3");
  faults.not_negative("interaction", p.interaction, "J");
  faults.not_negative("friction", p.friction, "");
  faults.positive("tangential", p.tangential, "");
  faults.positive("drag", p.drag, "");
  if (!(p.time_step > 0.0 && p.time_step <= 0.8)) {
    faults.add("time_step", p.time_step, "", "> 0 and <= 0.8", "stability of velocity Verlet");
  }
  if (!faults.any()) {
    const double volume = kPi / 4.0 * p.d_f * p.d_f * p.segment_length *
                          static_cast<double>(p.n_beads - 1) * static_cast<double>(p.n_fibers);
    const double side = std::cbrt(volume / p.v_f);
    if (side < 4.0 * (p.segment_length + 1.5 * p.d_f)) {
      faults.add("box side", side, "m",
                 format(">= %.6g m, four segments", 4.0 * (p.segment_length + 1.5 * p.d_f)),
                 "more fibers, more beads or a lower v_f");
    }
  }
  faults.raise_if_any();
}

namespace {

/// A thread needs some hundred segments a step to be worth waking.
std::size_t useful_threads(const BeadSpringParams& p) {
  return std::clamp<std::size_t>(p.n_fibers * p.n_beads / 600, 1, resolve_threads(0));
}

}  // namespace

struct BeadSpringNetwork::Implementation {
  BeadSpringParams p;
  ThreadTeam team;
  std::size_t beads, segments_per_fiber;
  std::vector<Vec> x, v, force;
  std::vector<double> rest;
  Vec box;
  double mass, stretch, bend, interaction, reach, dt, drag, tangential;
  std::size_t step = 0;
  double v_start = 0.0, work = 0.0, friction_loss = 0.0, drag_loss = 0.0;
  bool soft = false;

  // Neighbor list: pairs sorted by (a, b); for every segment the places where it takes part.
  std::vector<Pair> pairs;
  std::vector<Vec> spring;
  std::vector<Touch> touch;
  TouchingPairs touching() const {
    TouchingPairs near;
    for (std::size_t k = 0; k < pairs.size(); ++k) {
      if (touch[k].active) near[{pairs[k].a, pairs[k].b}] = &touch[k];
    }
    return near;
  }
  std::vector<std::size_t> share_start, share;
  std::vector<Vec> x_listed;
  double strain_listed = 0.0;
  double skin;
  bool listed = false;

  struct FiberSums {
    double stretching = 0, bending = 0, kinetic = 0, drag = 0, max_force = 0, moved = 0;
    Vec virial = Vec::Zero();
  };
  std::vector<FiberSums> fiber_sums;
  Vec virial = Vec::Zero();
  double pair_energy = 0, pair_tangential = 0;

  explicit Implementation(const BeadSpringParams& params, std::size_t threads)
      : p(params),
        team(threads > 0 ? threads : useful_threads(params)),
        beads(params.n_fibers * params.n_beads),
        segments_per_fiber(params.n_beads - 1) {
    validate(p);
    const double area = kPi / 4.0 * p.d_f * p.d_f;
    const double l = p.segment_length;
    mass = p.density * area * l;
    stretch = p.E * area * l;
    bend = p.E * kPi / 64.0 * std::pow(p.d_f, 4) / l;
    interaction = p.interaction > 0.0 ? p.interaction : 0.41 * p.E * std::pow(p.d_f, 3);
    reach = p.d_f;
    const double normal_stiffness = interaction * 15.0 / 8.0 * std::sqrt(0.05) / (p.d_f * p.d_f);
    tangential = p.tangential * normal_stiffness;
    // Highest frequency of chain and contact together bounds the step.
    const double frequency = std::sqrt(
        (4.0 * stretch / (l * l) + 64.0 * bend / (l * l) + 4.0 * normal_stiffness) / mass);
    dt = p.time_step * 2.0 / frequency;
    drag = p.drag * std::sqrt(4.0 * stretch / (l * l * mass));
    skin = 0.4 * p.d_f;
    x.resize(beads);
    v.assign(beads, Vec::Zero());
    force.assign(beads, Vec::Zero());
    rest.assign(beads, 0.0);
    fiber_sums.resize(p.n_fibers);
  }

  void lay() {
    const double volume = fiber_volume();
    box = Vec::Constant(std::cbrt(volume / p.v_f));
    v_start = p.v_f;
    Random random(p.seed);
    for (std::size_t fiber = 0; fiber < p.n_fibers; ++fiber) {
      Vec direction;
      double length = 2.0;
      while (length > 1.0 || length < 1e-6) {
        direction = {random.uniform(-1.0, 1.0), random.uniform(-1.0, 1.0),
                     random.uniform(-1.0, 1.0)};
        length = direction.norm();
      }
      direction[2] /= p.ratio;
      direction.normalize();
      Vec place(random.uniform() * box[0], random.uniform() * box[1], random.uniform() * box[2]);
      for (std::size_t i = 0; i < p.n_beads; ++i) {
        x[fiber * p.n_beads + i] = place;
        place += p.segment_length * direction;
        if (p.crimp > 0.0) {
          // Isotropic walk of the direction: two normal components across, crimp in total.
          Vec side = direction.unitOrthogonal();
          const Vec other = direction.cross(side);
          const double amount = p.crimp / std::numbers::sqrt2;
          const double first = amount * random.normal();
          const double second = amount * random.normal();
          const double angle = std::hypot(first, second);
          const Vec across = angle > 0.0 ? Vec((first * side + second * other) / angle) : side;
          direction = (std::cos(angle) * direction + std::sin(angle) * across).normalized();
        }
      }
      for (std::size_t i = 1; i + 1 < p.n_beads; ++i) {
        rest[fiber * p.n_beads + i] = turning(fiber * p.n_beads + i);
      }
    }
  }

  [[nodiscard]] double fiber_volume() const {
    return kPi / 4.0 * p.d_f * p.d_f * p.segment_length * static_cast<double>(segments_per_fiber) *
           static_cast<double>(p.n_fibers);
  }
  [[nodiscard]] double fraction() const { return fiber_volume() / box.prod(); }

  [[nodiscard]] double turning(std::size_t i) const {
    const Vec before = x[i] - x[i - 1];
    const Vec after = x[i + 1] - x[i];
    return std::atan2(before.cross(after).norm(), before.dot(after));
  }

  [[nodiscard]] Vec nearest_image(Vec d) const {
    for (int k = 0; k < 3; ++k) d[k] -= box[k] * std::round(d[k] / box[k]);
    return d;
  }

  /// Pairs of segments whose axes may come within reach before the list is made again.
  void make_list() {
    const double far = 1.05 * p.segment_length + reach + skin;
    for (int k = 0; k < 3; ++k) {
      if (box[k] < 2.0 * far) {
        throw ModelError(
            format("bead-spring network: box side %d = %.6g m at v_f = %.6g, must be "
                   ">= %.6g m (start from more fibers or a lower v_f)",
                   k + 1, box[k], fraction(), 2.0 * far));
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
        const double part =
            middle[static_cast<Eigen::Index>(k)] / box[static_cast<Eigen::Index>(k)];
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

  void check_list() {
    if (listed) {
      double moved = 0.0;
      for (const FiberSums& sums : fiber_sums) moved = std::max(moved, sums.moved);
      // Two beads may approach by twice the movement; straining brings distant points nearer too.
      if (2.0 * std::sqrt(moved) + strain_listed * (p.segment_length + reach) < skin) return;
    }
    make_list();
  }

  /// Repulsion energy and -dE/dr at distance r.
  [[nodiscard]] std::pair<double, double> repel(double r) const {
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
    return {-interaction * log * fade,
            interaction * fade * (1.0 / q - log * reach / (back * back))};
  }

  /// Forces, energies, virial. With `slide` the tangential springs are advanced by a step.
  void compute_forces(bool slide) {
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
            const Vec speed = (1.0 - near.s) * v[a] + near.s * v[a + 1] - (1.0 - near.t) * v[b] -
                              near.t * v[b + 1];
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

  void fiber_forces(std::size_t fiber) {
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

  [[nodiscard]] double pressure() const { return virial[2] / box.prod(); }

  void strain_box(double strain) {
    if (strain == 0.0) return;
    const double factor = std::exp(-strain);
    box[2] *= factor;
    team.run(beads, [&](std::size_t begin, std::size_t end) {
      for (std::size_t i = begin; i < end; ++i) {
        x[i][2] *= factor;
        x_listed[i][2] *= factor;
      }
    });
    strain_listed += std::abs(strain);
  }

  void integrate(std::size_t steps, double strain, double rate_of_drag, bool book) {
    const double shrink = std::exp(-rate_of_drag * dt);
    if (!listed) compute_forces(false);
    for (std::size_t n = 0; n < steps; ++n) {
      // The box does its work against the mean of the pressures before and after the strain.
      const double before = virial[2];
      strain_box(strain);
      team.run(p.n_fibers, [&](std::size_t begin, std::size_t end) {
        for (std::size_t fiber = begin; fiber < end; ++fiber) {
          double lost = 0.0;
          double moved = 0.0;
          for (std::size_t i = fiber * p.n_beads; i < (fiber + 1) * p.n_beads; ++i) {
            v[i] += 0.5 * dt / mass * force[i];
            const double energy = v[i].squaredNorm();
            v[i] *= shrink;
            lost += 0.5 * mass * (energy - v[i].squaredNorm());
            x[i] += dt * v[i];
            moved = std::max(moved, (x[i] - x_listed[i]).squaredNorm());
          }
          fiber_sums[fiber].drag = lost;
          fiber_sums[fiber].moved = moved;
        }
      });
      double lost = 0.0;
      double fastest = 0.0;
      for (const FiberSums& sums : fiber_sums) {
        lost += sums.drag;
        fastest = std::max(fastest, sums.moved);
      }
      if (!(fastest < p.segment_length * p.segment_length)) {
        throw ModelError(
            format("bead-spring network: a bead moved more than a segment near step "
                   "%zu (v_f = %.6g); reduce time_step or the strain per step",
                   step, fraction()));
      }
      compute_forces(true);
      team.run(beads, [&](std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i) v[i] += 0.5 * dt / mass * force[i];
      });
      if (book) {
        work += 0.5 * (before + virial[2]) * strain;
        drag_loss += lost;
        ++step;
      }
    }
  }
};

BeadSpringNetwork::BeadSpringNetwork(const BeadSpringParams& params, std::size_t threads)
    : self_(std::make_unique<Implementation>(params, threads)) {
  self_->lay();
}

BeadSpringNetwork::BeadSpringNetwork(const BeadSpringParams& params, const BeadSpringState& state,
                                     std::size_t threads)
    : self_(std::make_unique<Implementation>(params, threads)) {
  Implementation& s = *self_;
  Faults faults("bead-spring state");
  const auto expect = [&](const char* name, std::size_t got, std::size_t wanted) {
    if (got != wanted) {
      faults.add_text(format("%s has %zu numbers, expected %zu", name, got, wanted));
    }
  };
  expect("positions", state.positions.size(), 3 * s.beads);
  expect("velocities", state.velocities.size(), 3 * s.beads);
  expect("rest_angles", state.rest_angles.size(), s.beads);
  expect("box", state.box.size(), 3);
  expect("books", state.books.size(), 5);
  expect("contact_springs", state.contact_springs.size(), state.contact_pairs.size() / 2 * 3);
  faults.raise_if_any();
  for (std::size_t i = 0; i < s.beads; ++i) {
    s.x[i] = {state.positions[3 * i], state.positions[3 * i + 1], state.positions[3 * i + 2]};
    s.v[i] = {state.velocities[3 * i], state.velocities[3 * i + 1], state.velocities[3 * i + 2]};
  }
  s.rest = state.rest_angles;
  s.box = {state.box[0], state.box[1], state.box[2]};
  s.step = static_cast<std::size_t>(state.books[0]);
  s.v_start = state.books[1];
  s.work = state.books[2];
  s.friction_loss = state.books[3];
  s.drag_loss = state.books[4];
  for (std::size_t k = 0; k < state.contact_pairs.size() / 2; ++k) {
    s.pairs.push_back({state.contact_pairs[2 * k], state.contact_pairs[2 * k + 1]});
    s.spring.emplace_back(state.contact_springs[3 * k], state.contact_springs[3 * k + 1],
                          state.contact_springs[3 * k + 2]);
  }
  // make_list carries the springs over and completes the list.
  s.make_list();
  s.compute_forces(false);
}

BeadSpringNetwork::~BeadSpringNetwork() = default;

const BeadSpringParams& BeadSpringNetwork::params() const { return self_->p; }

void BeadSpringNetwork::relax(std::size_t steps) {
  Implementation& s = *self_;
  s.soft = true;
  s.compute_forces(false);
  s.integrate(steps, 0.0, 2.0 * s.drag, false);
  s.soft = false;
  s.integrate(steps / 4, 0.0, 2.0 * s.drag, false);
  for (Vec& velocity : s.v) velocity.setZero();
  for (Vec& stretch : s.spring) stretch.setZero();
  s.friction_loss = 0.0;
  s.compute_forces(false);
}

void BeadSpringNetwork::advance(std::size_t steps, double strain_per_step) {
  if (!(std::abs(strain_per_step) < 0.01)) {
    throw InvalidParameter(
        format("bead-spring network: strain_per_step = %.6g, must be between "
               "-0.01 and 0.01",
               strain_per_step));
  }
  self_->integrate(steps, strain_per_step, self_->drag, true);
}

BeadSpringSample BeadSpringNetwork::sample() {
  Implementation& s = *self_;
  if (!s.listed) s.compute_forces(false);
  BeadSpringSample r{};
  r.step = s.step;
  r.v_f = s.fraction();
  r.strain = std::log(r.v_f / s.v_start);
  r.pressure = s.pressure();
  r.lateral = 0.5 * (s.virial[0] + s.virial[1]) / s.box.prod();
  for (const auto& sums : s.fiber_sums) {
    r.stretching += sums.stretching;
    r.bending += sums.bending;
    r.max_force = std::max(r.max_force, sums.max_force / (s.p.E * s.p.d_f * s.p.d_f));
  }
  for (const Vec& velocity : s.v) r.kinetic += 0.5 * s.mass * velocity.squaredNorm();
  r.repulsion = s.pair_energy;
  r.tangential = s.pair_tangential;
  r.work = s.work;
  r.friction_loss = s.friction_loss;
  r.drag_loss = s.drag_loss;
  r.smallest_distance = 1.0;
  const TouchingPairs near = s.touching();
  for (const auto& [pair, here] : near) {
    r.smallest_distance = std::min(r.smallest_distance, here->distance / s.p.d_f);
    r.contacts += nearest_of_place(near, pair, *here);
  }
  return r;
}

BeadSpringState BeadSpringNetwork::state() const {
  const Implementation& s = *self_;
  BeadSpringState state;
  for (std::size_t i = 0; i < s.beads; ++i) {
    for (int k = 0; k < 3; ++k) {
      state.positions.push_back(s.x[i][k]);
      state.velocities.push_back(s.v[i][k]);
    }
  }
  state.rest_angles = s.rest;
  state.box = {s.box[0], s.box[1], s.box[2]};
  state.books = {static_cast<double>(s.step), s.v_start, s.work, s.friction_loss, s.drag_loss};
  for (std::size_t k = 0; k < s.pairs.size(); ++k) {
    if (s.spring[k].squaredNorm() == 0.0) continue;
    state.contact_pairs.push_back(s.pairs[k].a);
    state.contact_pairs.push_back(s.pairs[k].b);
    for (int c = 0; c < 3; ++c) state.contact_springs.push_back(s.spring[k][c]);
  }
  return state;
}

double BeadSpringNetwork::energy_and_forces(std::vector<double>& forces) {
  Implementation& s = *self_;
  const double mu = s.p.friction;
  s.p.friction = 0.0;
  s.listed = false;
  s.compute_forces(false);
  s.p.friction = mu;
  forces.clear();
  for (const Vec& f : s.force) forces.insert(forces.end(), {f[0], f[1], f[2]});
  double energy = s.pair_energy;
  for (const auto& sums : s.fiber_sums) energy += sums.stretching + sums.bending;
  return energy;
}

std::size_t BeadSpringNetwork::crossings() {
  Implementation& s = *self_;
  if (!s.listed) s.compute_forces(false);
  std::size_t count = 0;
  const auto end_of_fiber = [&](std::int64_t segment, double place) {
    const std::int64_t index = segment % static_cast<std::int64_t>(s.p.n_beads);
    return (place == 0.0 && index == 0) ||
           (place == 1.0 && index + 2 == static_cast<std::int64_t>(s.p.n_beads));
  };
  const TouchingPairs near = s.touching();
  for (const auto& [pair, here] : near) {
    if (nearest_of_place(near, pair, *here) && !end_of_fiber(pair.first, here->s) &&
        !end_of_fiber(pair.second, here->t)) {
      ++count;
    }
  }
  return count;
}

Directions BeadSpringNetwork::directions() const {
  const Implementation& s = *self_;
  Directions result(static_cast<Eigen::Index>(s.p.n_fibers * s.segments_per_fiber), 3);
  Eigen::Index row = 0;
  for (std::size_t i = 0; i < s.beads; ++i) {
    if (i % s.p.n_beads + 1 == s.p.n_beads) continue;
    result.row(row++) = (s.x[i + 1] - s.x[i]).normalized().transpose();
  }
  return result;
}

std::vector<double> BeadSpringNetwork::free_lengths() {
  Implementation& s = *self_;
  if (!s.listed) s.compute_forces(false);
  std::vector<std::vector<double>> places(s.p.n_fibers);
  for (std::size_t k = 0; k < s.pairs.size(); ++k) {
    if (!s.touch[k].active) continue;
    const auto add = [&](std::int64_t segment, double place) {
      const auto i = static_cast<std::size_t>(segment);
      places[i / s.p.n_beads].push_back((static_cast<double>(i % s.p.n_beads) + place) *
                                        s.p.segment_length);
    };
    add(s.pairs[k].a, s.touch[k].s);
    add(s.pairs[k].b, s.touch[k].t);
  }
  std::vector<double> lengths;
  for (auto& list : places) {
    std::sort(list.begin(), list.end());
    for (std::size_t i = 1; i < list.size(); ++i) lengths.push_back(list[i] - list[i - 1]);
  }
  return lengths;
}

}  // namespace feltmb
