#include "feltmb/planar/poses.hpp"

#include <cmath>

#include "feltmb/core/error.hpp"

namespace feltmb {
namespace {

/// Locates everything in the pose `q`, with strings and laws at rest.
void locate(Dynamics& dynamics, const Eigen::VectorXd& q, Detail detail) {
  const Mechanism& mechanism = dynamics.mechanism();
  const std::vector<double> modes(static_cast<std::size_t>(mechanism.total_modes), 0.0);
  const std::vector<double> rest(static_cast<std::size_t>(mechanism.size()), 0.0);
  const std::vector<double> law(static_cast<std::size_t>(mechanism.total_law_states), 0.0);
  dynamics.locate({{q.data(), rest.size()}, rest, law, modes, modes}, {}, detail);
}

}  // namespace

std::array<double, 3> pose_of(const Dynamics& dynamics, const Placement& placement) {
  const LinkState& s = dynamics.links()[static_cast<std::size_t>(placement.link)];
  const Vec2 origin = s.origin + s.rotation * placement.offset;
  return {origin.x, origin.y, std::atan2(s.rotation.s, s.rotation.c) + placement.angle};
}

Eigen::MatrixXd centerline(const FlexibleBeam& beam, const Eigen::VectorXd& q, int count) {
  Eigen::MatrixXd out(count, 2);
  for (int i = 0; i < count; ++i) {
    const double x = beam.length * i / (count - 1);
    const ShapeValues v = beam.shapes.at(x);
    double u = 0.0;
    double w = 0.0;
    for (int k = 0; k < beam.count; ++k) {
      const double e = q[beam.first + k];
      const int lateral = k - beam.shapes.axial();
      if (lateral < 0)
        u += e * v.axial[static_cast<std::size_t>(k)];
      else
        w += e * v.lateral[static_cast<std::size_t>(lateral)];
    }
    out(i, 0) = x + u;
    out(i, 1) = w;
  }
  return out;
}

Dynamics located(const std::shared_ptr<const Mechanism>& mechanism, const Eigen::VectorXd& q) {
  if (q.size() != mechanism->size()) {
    throw InvalidParameter(format("got q of length %ld, expected %d (the coordinates)",
                                  static_cast<long>(q.size()), mechanism->size()));
  }
  Dynamics dynamics(mechanism);
  locate(dynamics, q, Detail::kClosedContacts);
  return dynamics;
}

double finger_place(const std::shared_ptr<const Mechanism>& mechanism, const Eigen::VectorXd& q) {
  if (mechanism->finger_contact < 0) throw InvalidParameter("the mechanism has no finger");
  const Dynamics dynamics = located(mechanism, q);
  return dot(mechanism->finger_direction, dynamics.position(mechanism->finger_point));
}

Poses poses_along(const std::shared_ptr<const Mechanism>& mechanism, const Eigen::MatrixXd& q,
                  int count) {
  if (q.cols() != mechanism->size() || !q.allFinite()) {
    throw InvalidParameter(format("move_through: got poses of %ld coordinates, expected %d, finite",
                                  static_cast<long>(q.cols()), mechanism->size()));
  }
  Poses out;
  for (const auto& [name, placement] : mechanism->bodies) out.names.push_back(name);
  std::vector<std::size_t> chosen;
  for (std::size_t i = 0; i < mechanism->contacts.size(); ++i) {
    if (mechanism->contacts[i].finger) continue;
    chosen.push_back(i);
    out.numbers.push_back(mechanism->contacts[i].number);
  }
  out.bodies.resize(q.rows(), 3 * static_cast<Eigen::Index>(out.names.size()));
  out.contacts.resize(q.rows(), 4 * static_cast<Eigen::Index>(chosen.size()));
  for (const FlexibleBeam& beam : mechanism->beams) {
    out.beams.emplace_back(beam.name, Eigen::MatrixXd(q.rows(), 2 * count));
  }
  Dynamics dynamics(mechanism);
  for (Eigen::Index row = 0; row < q.rows(); ++row) {
    const Eigen::VectorXd position = q.row(row);
    locate(dynamics, position, Detail::kAllContacts);
    Eigen::Index column = 0;
    for (const auto& [name, placement] : mechanism->bodies) {
      for (const double value : pose_of(dynamics, placement)) out.bodies(row, column++) = value;
    }
    column = 0;
    for (const std::size_t i : chosen) {
      const ContactState& s = dynamics.contacts()[i];
      for (const double value : {s.point.x, s.point.y, s.normal.x, s.normal.y}) {
        out.contacts(row, column++) = value;
      }
    }
    for (std::size_t b = 0; b < out.beams.size(); ++b) {
      const Eigen::MatrixXd line = centerline(mechanism->beams[b], position, count);
      for (Eigen::Index i = 0; i < count; ++i) {
        out.beams[b].second.block<1, 2>(row, 2 * i) = line.row(i);
      }
    }
  }
  return out;
}

}  // namespace feltmb
