#include "feltmb/core/index.hpp"
#include "feltmb/planar/dynamics.hpp"

namespace feltmb {

namespace {

constexpr std::pair<const char*, InputKind> kInputs[] = {
    {"force", InputKind::kForce},
    {"motion", InputKind::kMotion},
    {"key_motion", InputKind::kKeyMotion},
    {"torque", InputKind::kTorque},
    {"motor_motion", InputKind::kMotorMotion},
};

}  // namespace

const char* input_name(InputKind kind) {
  for (const auto& [name, own] : kInputs) {
    if (own == kind) return name;
  }
  return "?";
}

InputKind input_kind(const std::string& name) {
  std::string known;
  for (const auto& [own, kind] : kInputs) {
    if (name == own) return kind;
    known += (known.empty() ? "" : ", ") + std::string(own);
  }
  throw InvalidParameter("input \"" + name + "\" is unknown; known are " + known);
}

/// Finds the reaction and corrects the accelerations; see Prescription.
void Dynamics::prescribe(const Drive& drive) {
  Prescription& p = prescription_;
  driven_coordinate_ = drive.coordinate;
  double error = -drive.displacement;
  double speed_error = -drive.speed;
  double bias = 0.0;
  p.row.setZero();
  if (drive.coordinate >= 0) {
    p.row[drive.coordinate] = 1.0;
    error += q_[as_index(drive.coordinate)];
    speed_error += v_[as_index(drive.coordinate)];
  } else {
    const int link = m_->finger_point.link;
    const Vec2 direction = m_->finger_direction;
    const Vec2 point = position(m_->finger_point);
    for (const int motion : m_->links[as_index(link)].path) {
      p.row[m_->motions[as_index(motion)].coordinate] = dot(direction, column(motion, point));
    }
    const LinkState& state = links_[as_index(link)];
    error += dot(direction, point);
    speed_error += dot(direction, velocity(m_->finger_point));
    bias = dot(direction, state.bias - (state.omega * state.omega) * (point - state.origin));
  }
  for (const int k : condensed_) p.row[k] = 0.0;
  response_ = p.row;
  solve_mass(response_);
  constexpr double c = Prescription::rate;
  const double wanted = drive.acceleration - bias - 2.0 * c * speed_error - c * c * error;
  p.reaction = (wanted - p.row.dot(acceleration_)) / p.row.dot(response_);
  acceleration_ += p.reaction * response_;
  force_ += p.reaction * p.row;
  if (drive.coordinate < 0) {
    // Not projected any more; differentiate() turns the force with its link.
    apply(m_->finger_point.link, position(m_->finger_point), p.reaction * m_->finger_direction);
  }
}

/// After complete_links: d(J a + bias)/dq = d2J/dt2 and d(J a + bias)/dv = 2 dJ/dt.
void Dynamics::differentiate_prescription() {
  Prescription& p = prescription_;
  p.by_position.setZero();
  p.by_speed.setZero();
  constexpr double c = Prescription::rate;
  if (driven_coordinate_ >= 0) {
    p.by_position[driven_coordinate_] = c * c;
    p.by_speed[driven_coordinate_] = 2.0 * c;
    return;
  }
  const int link = m_->finger_point.link;
  const LinkState& state = links_[as_index(link)];
  const Vec2 direction = m_->finger_direction;
  const Vec2 point = position(m_->finger_point);
  const Vec2 arm = point - state.origin;
  const Vec2 speed = velocity(m_->finger_point);
  const Vec2 acceleration =
      state.acceleration + state.alpha * perp(arm) - (state.omega * state.omega) * arm;
  for (const int motion : m_->links[as_index(link)].path) {
    const Motion& m = m_->motions[as_index(motion)];
    const LinkState& base = links_[as_index(m_->links[as_index(m.link)].parent)];
    const Vec2 t = translation_[as_index(motion)];
    const Vec2 second = base.alpha * perp(t) - (base.omega * base.omega) * t +
                        m.rho * perp(acceleration - links_[as_index(m.link)].acceleration);
    const double first = dot(direction, column_rate(motion, speed));
    const double own = dot(direction, column(motion, point));
    p.by_position[m.coordinate] = dot(direction, second) + 2.0 * c * first + c * c * own;
    p.by_speed[m.coordinate] = 2.0 * first + 2.0 * c * own;
  }
}

}  // namespace feltmb
