// Mass matrix and its sparse factors on random trees of bodies.
#include <doctest/doctest.h>

#include <Eigen/Dense>
#include <random>
#include <string>
#include <vector>

#include "feltmb/core/error.hpp"
#include "feltmb/planar/dynamics.hpp"

namespace {

using namespace feltmb;

std::string numbered(const char* word, int i) { return format("%s%d", word, i); }

/// A tree of `count` bodies with random parents; revolute, prismatic and now and then welded.
MechanismDescription random_tree(int count, unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> unit(-1.0, 1.0);
  MechanismDescription d;
  d.name = "tree";
  for (int i = 0; i < count; ++i) {
    BodyDescription b;
    b.name = numbered("body", i);
    const int parent = i == 0 ? -1 : static_cast<int>(random() % static_cast<unsigned>(i + 1)) - 1;
    b.parent = parent < 0 ? "ground" : numbered("body", parent);
    const unsigned kind = random() % 5;
    b.joint = kind < 3 ? JointKind::kRevolute : kind < 4 ? JointKind::kPrismatic : JointKind::kWeld;
    if (i == 0) b.joint = JointKind::kRevolute;
    if (b.joint != JointKind::kWeld) b.coordinate = numbered("c", i);
    b.position = {unit(random), unit(random)};
    const double turn = 3.0 * unit(random);
    b.axis = {std::cos(turn), std::sin(turn)};
    b.angle = unit(random);
    b.mass = 0.1 + 0.1 * (1.0 + unit(random));
    b.center_of_mass = {0.3 * unit(random), 0.3 * unit(random)};
    b.inertia = 1e-3 * (1.1 + unit(random));
    d.bodies.push_back(b);
  }
  return d;
}

struct Evaluated {
  std::shared_ptr<const Mechanism> mechanism;
  std::vector<double> q, v;
};

Evaluated random_state(int count, unsigned seed) {
  Evaluated e;
  e.mechanism = assemble(random_tree(count, seed));
  std::mt19937 random(seed + 1000);
  std::normal_distribution<double> normal;
  for (int k = 0; k < e.mechanism->size(); ++k) {
    e.q.push_back(normal(random));
    e.v.push_back(3.0 * normal(random));
  }
  return e;
}

/// Twice the kinetic energy from the motion of the links.
double vis_viva(const Dynamics& dynamics) {
  double sum = 0.0;
  for (std::size_t i = 1; i < dynamics.links().size(); ++i) {
    const auto& link = dynamics.mechanism().links[i];
    const Vec2 v = dynamics.velocity({static_cast<int>(i), link.center_of_mass});
    const double w = dynamics.links()[i].omega;
    sum += link.mass * dot(v, v) + link.inertia * w * w;
  }
  return sum;
}

}  // namespace

TEST_CASE("solve with the sparse factors is the dense solve") {
  for (unsigned seed = 0; seed < 40; ++seed) {
    const auto e = random_state(1 + static_cast<int>(seed % 14), seed);
    Dynamics dynamics(e.mechanism);
    dynamics.evaluate({e.q, e.v, {}, {}, {}}, {});
    const Eigen::MatrixXd m = dynamics.mass_matrix();
    CHECK((m - m.transpose()).cwiseAbs().maxCoeff() == 0.0);
    const Eigen::LDLT<Eigen::MatrixXd> dense(m);
    CHECK(dense.isPositive());
    const Eigen::VectorXd expected = dense.solve(dynamics.force());
    const double size = expected.cwiseAbs().maxCoeff();
    CHECK((dynamics.acceleration() - expected).cwiseAbs().maxCoeff() < 1e-9 * size);
    Eigen::VectorXd b = Eigen::VectorXd::Random(m.rows());
    const Eigen::VectorXd x = dense.solve(b);
    dynamics.solve_mass(b);
    CHECK((b - x).cwiseAbs().maxCoeff() < 1e-9 * x.cwiseAbs().maxCoeff());
  }
}

TEST_CASE("the mass matrix gives the kinetic energy of the links") {
  for (unsigned seed = 0; seed < 20; ++seed) {
    auto e = random_state(8, seed);
    Dynamics dynamics(e.mechanism);
    const auto n = e.q.size();
    const auto energy = [&](std::size_t a, std::size_t b) {
      std::vector<double> v(n, 0.0);
      v[a] += 1.0;
      if (b != a) v[b] += 1.0;
      dynamics.evaluate({e.q, v, {}, {}, {}}, {});
      return vis_viva(dynamics);
    };
    for (std::size_t a = 0; a < n; ++a) {
      for (std::size_t b = 0; b <= a; ++b) {
        const double whole = energy(a, b);
        const double expected = a == b ? whole : 0.5 * (whole - energy(a, a) - energy(b, b));
        const auto entry =
            dynamics.mass_matrix()(static_cast<Eigen::Index>(a), static_cast<Eigen::Index>(b));
        CHECK(std::fabs(entry - expected) < 1e-12 * (1.0 + std::fabs(expected)));
      }
    }
  }
}

TEST_CASE("the accelerations obey the power balance of a frictionless tree") {
  // d(kinetic)/dt = power of gravity, for any velocities: a check of the quadratic terms.
  for (unsigned seed = 0; seed < 20; ++seed) {
    const auto e = random_state(7, seed);
    Dynamics dynamics(e.mechanism);
    dynamics.evaluate({e.q, e.v, {}, {}, {}}, {});
    const Eigen::VectorXd a = dynamics.acceleration();
    double gravity = 0.0;
    for (std::size_t i = 1; i < dynamics.links().size(); ++i) {
      const auto& link = e.mechanism->links[i];
      gravity += link.mass * dot(e.mechanism->gravity,
                                 dynamics.velocity({static_cast<int>(i), link.center_of_mass}));
    }
    const double h = 1e-6;
    double energy[2];
    for (const int sign : {0, 1}) {
      const double dt = sign == 0 ? -h : h;
      std::vector<double> q = e.q, v = e.v;
      for (std::size_t k = 0; k < q.size(); ++k) {
        const double ak = a[static_cast<Eigen::Index>(k)];
        q[k] += dt * e.v[k] + 0.5 * dt * dt * ak;
        v[k] += dt * ak;
      }
      dynamics.evaluate({q, v, {}, {}, {}}, {});
      energy[sign] = 0.5 * vis_viva(dynamics);
    }
    const double rate = (energy[1] - energy[0]) / (2.0 * h);
    CHECK(rate == doctest::Approx(gravity).epsilon(1e-6).scale(std::fabs(energy[0]) * 1e-2));
  }
}
