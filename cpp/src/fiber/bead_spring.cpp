#include "feltmb/fiber/bead_spring.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "bead_spring_box.hpp"
#include "feltmb/fiber/faults.hpp"
#include "feltmb/numeric/constants.hpp"
#include "feltmb/numeric/random.hpp"

namespace feltmb {
namespace {

using namespace bead_spring;

constexpr double kRelaxingDrag = 0.01;  // least drag of relax() over the stretching frequency

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

BeadSpringNetwork::Implementation::Implementation(const BeadSpringParams& params,
                                                  std::size_t threads)
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
  const double frequency =
      std::sqrt((4.0 * stretch / (l * l) + 64.0 * bend / (l * l) + 4.0 * normal_stiffness) / mass);
  dt = p.time_step * 2.0 / frequency;
  drag = p.drag * std::sqrt(4.0 * stretch / (l * l * mass));
  skin = 0.4 * p.d_f;
  x.resize(beads);
  v.assign(beads, Vec::Zero());
  force.assign(beads, Vec::Zero());
  rest.assign(beads, 0.0);
  fiber_sums.resize(p.n_fibers);
}

void BeadSpringNetwork::Implementation::lay() {
  const double volume = fiber_volume();
  box = Vec::Constant(std::cbrt(volume / p.v_f));
  v_start = p.v_f;
  Random random(p.seed);
  for (std::size_t fiber = 0; fiber < p.n_fibers; ++fiber) {
    Vec direction;
    double length = 2.0;
    while (length > 1.0 || length < 1e-6) {
      direction = {random.uniform(-1.0, 1.0), random.uniform(-1.0, 1.0), random.uniform(-1.0, 1.0)};
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

double BeadSpringNetwork::Implementation::shortest_side() const {
  return 2.0 * (1.05 * p.segment_length + reach + skin);
}

double BeadSpringNetwork::Implementation::fiber_volume() const {
  return kPi / 4.0 * p.d_f * p.d_f * p.segment_length * static_cast<double>(segments_per_fiber) *
         static_cast<double>(p.n_fibers);
}

void BeadSpringNetwork::Implementation::strain_box(double strain) {
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

void BeadSpringNetwork::Implementation::integrate(std::size_t steps, double strain,
                                                  double rate_of_drag, bool book) {
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
      throw ModelError(format("bead-spring network: a bead moved more than a segment near step "
                              "%zu (v_f = %.6g); reduce time_step or the strain per step",
                              step, fraction()),
                       ErrorCode::kNotConverged);
    }
    compute_forces(true);
    if (!std::isfinite(virial[2])) {  // a NaN compares like a bead that stays
      throw ModelError(
          format("bead-spring network: forces are not finite at step %zu (v_f = %.6g); reduce "
                 "time_step or the strain per step",
                 step, fraction()),
          ErrorCode::kNotFinite);
    }
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
  const auto finite = [&](const char* name, const std::vector<double>& values) {
    if (!std::all_of(values.begin(), values.end(), [](double x) { return std::isfinite(x); })) {
      faults.add_text(format("%s holds a number that is not finite", name));
    }
  };
  finite("positions", state.positions);
  finite("velocities", state.velocities);
  finite("rest_angles", state.rest_angles);
  finite("box", state.box);
  finite("books", state.books);
  finite("contact_springs", state.contact_springs);
  for (std::size_t k = 0; k + 1 < state.contact_pairs.size(); k += 2) {
    const std::int64_t first = state.contact_pairs[k];
    const std::int64_t second = state.contact_pairs[k + 1];
    if (!(0 <= first && first < second && second + 1 < static_cast<std::int64_t>(s.beads))) {
      faults.add_text(format("contact_pairs has the pair %lld, %lld, expected 0 <= a < b < %zu",
                             static_cast<long long>(first), static_cast<long long>(second),
                             s.beads - 1));
      break;
    }
  }
  if (state.books.size() == 5 && !(state.books[0] >= 0.0 && state.books[0] < 1e15)) {
    faults.add_text(format("books begins with step %.6g, expected 0 to 1e15", state.books[0]));
  }
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

double BeadSpringNetwork::densest() const {
  const Vec& side = self_->box;
  return self_->fiber_volume() / (side[0] * side[1] * self_->shortest_side());
}

void BeadSpringNetwork::relax(std::size_t steps) {
  Implementation& s = *self_;
  // The drag of a slow run would leave the box ringing with what the overlaps set free.
  const double strong = 2.0 * s.drag * std::max(1.0, kRelaxingDrag / s.p.drag);
  s.soft = true;
  s.compute_forces(false);
  s.integrate(steps, 0.0, strong, false);
  s.soft = false;
  s.integrate(steps / 4, 0.0, strong, false);
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
