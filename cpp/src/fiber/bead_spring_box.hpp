/// The periodic box of a bead-spring network: its state and what moves it. Private to the fibers.
#pragma once

#include <Eigen/Geometry>
#include <cmath>
#include <cstdint>
#include <map>
#include <utility>
#include <vector>

#include "feltmb/fiber/bead_spring.hpp"
#include "feltmb/numeric/parallel.hpp"

namespace feltmb::bead_spring {

using Vec = Eigen::Vector3d;

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

}  // namespace feltmb::bead_spring

namespace feltmb {

struct BeadSpringNetwork::Implementation {
  using Vec = bead_spring::Vec;
  using Pair = bead_spring::Pair;
  using Touch = bead_spring::Touch;
  using TouchingPairs = bead_spring::TouchingPairs;

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

  explicit Implementation(const BeadSpringParams& params, std::size_t threads);

  void lay();

  [[nodiscard]] double fiber_volume() const;
  [[nodiscard]] double shortest_side() const;  ///< of the box [m], to find neighbors

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
  void make_list();

  void check_list();

  /// Repulsion energy and -dE/dr at distance r.
  [[nodiscard]] std::pair<double, double> repel(double r) const;

  /// Forces, energies, virial. With `slide` the tangential springs are advanced by a step.
  void compute_forces(bool slide);

  void fiber_forces(std::size_t fiber);

  [[nodiscard]] double pressure() const { return virial[2] / box.prod(); }

  void strain_box(double strain);

  void integrate(std::size_t steps, double strain, double rate_of_drag, bool book);
};

}  // namespace feltmb
