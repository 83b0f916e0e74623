#include <algorithm>
#include <cmath>

#include "feltmb/core/index.hpp"
#include "feltmb/planar/dynamics.hpp"

namespace feltmb {
namespace {

/// Gap of the surfaces for which it takes a line of arithmetic; of others, -1.
double quick_gap(const Contact& contact, bool grounded, Rotation rotation, Vec2 d) {
  if (contact.kind == PairKind::kLineCircle) {
    return dot(grounded ? contact.normal_a : rotation * contact.normal_a, d) - contact.radius_b;
  }
  if (contact.kind == PairKind::kCircleCircle) return norm(d) - contact.radius_a - contact.radius_b;
  if (contact.kind == PairKind::kConcaveCircle) {
    return contact.radius_a - contact.radius_b - norm(d);
  }
  return -1.0;
}

/// The surface on link a, turned by `rotation`, against a circle whose center is d from `base`:
/// writes where it is met, and gives the compression.
struct Surface {
  const Contact& contact;
  Rotation rotation;
  Vec2 base;
  Vec2 d;
  ContactState& state;

  double compression() const {
    switch (contact.kind) {
      case PairKind::kLineCircle:
        return on_line(contact.normal_a, 0.0);
      case PairKind::kCircleCircle:
        return on_circle(1.0);
      case PairKind::kConcaveCircle:
        return on_circle(-1.0);
      case PairKind::kSegmentCircle:
        return on_segment();
      case PairKind::kConcaveArcCircle:
        return on_concave_arc();
      case PairKind::kHybridCircle:
        return on_hybrid();
    }
    return 0.0;
  }

  double on_line(Vec2 local_normal, double radius_a) const {
    state.normal = rotation * local_normal;
    return radius_a + contact.radius_b - dot(state.normal, d);
  }

  double on_circle(double sign) const {
    const double distance = turn_normal(d, base, sign);
    state.part = 1;
    return sign > 0.0 ? contact.radius_a + contact.radius_b - distance
                      : distance + contact.radius_b - contact.radius_a;
  }

  double on_end(int end, double radius_a) const {
    const Vec2 arm = rotation * contact.end[end];
    const double distance = turn_normal(d - arm, base + arm, 1.0);
    state.part = 2 + end;
    return radius_a + contact.radius_b - distance;
  }

  double on_segment() const {
    const Vec2 local = rotation.inverse(d);
    if (dot(local, contact.arc_tangent[0]) > 0.0) return on_end(0, contact.radius_a);
    if (dot(local - contact.end[1], contact.arc_tangent[1]) > 0.0) {
      return on_end(1, contact.radius_a);
    }
    // A bar has two faces, a line that ends has one.
    const bool behind = contact.radius_a > 0.0 && dot(local, contact.normal_a) < 0.0;
    return on_line(behind ? -contact.normal_a : contact.normal_a, contact.radius_a);
  }

  double on_concave_arc() const {
    const Vec2 local = rotation.inverse(d);
    // Within the arc is what lies before both ends, of an arc beyond a half turn before one.
    const bool past_first = dot(local, contact.arc_tangent[0]) > 0.0;
    const bool past_second = dot(local, contact.arc_tangent[1]) > 0.0;
    if (contact.more_than_half ? !(past_first && past_second) : !(past_first || past_second)) {
      return on_circle(-1.0);
    }
    return on_end(norm(local - contact.end[1]) < norm(local - contact.end[0]) ? 1 : 0, 0.0);
  }

  double on_hybrid() const {
    const Vec2 local = rotation.inverse(d);
    const bool first = dot(local, contact.arc_tangent[0]) > 0.0;
    const bool second = dot(local, contact.arc_tangent[1]) > 0.0;
    if (!first && !second) return on_circle(1.0);
    // Where both half-planes claim the center, the nearer boundary is the surface.
    const bool use_second =
        second && (!first || dot(local, contact.arc_normal[1]) > dot(local, contact.arc_normal[0]));
    return on_line(contact.arc_normal[use_second ? 1 : 0], contact.radius_a);
  }

  /// The normal follows the line from `from` to the center, `arm` away; returns its length.
  double turn_normal(Vec2 arm, Vec2 from, double sign) const {
    const double distance = norm(arm);
    state.turning_normal = true;
    state.base = from;
    state.curvature = distance > 1e-12 ? sign / distance : 0.0;
    state.normal = distance > 1e-12 ? (sign / distance) * arm : Vec2{1.0, 0.0};
    return distance;
  }
};

}  // namespace

double Dynamics::turn(std::size_t i) const {
  const Link& link = m_->links[i];
  if (link.kind == LinkKind::kRevolute) {
    return link.angle + q_[as_index(twist_[as_index(link.motions[0])].coordinate)];
  }
  double turn = 0.0;
  for (const int index : link.motions)
    turn += twist_[as_index(index)].rho * q_[as_index(twist_[as_index(index)].coordinate)];
  return turn;
}

void Dynamics::move_link(std::size_t i, Rotation own) {
  const Link& link = m_->links[i];
  const LinkState& parent = links_[as_index(link.parent)];
  LinkState& state = links_[i];
  if (link.kind == LinkKind::kRevolute) {
    const std::size_t index = as_index(link.motions[0]);
    Twist& twist = twist_[index];
    const std::size_t k = as_index(twist.coordinate);
    const Vec2 arm = parent.rotation * link.position;
    state.origin = parent.origin + arm;
    state.rotation = parent.rotation * own;
    state.omega = parent.omega + v_[k];
    state.velocity = parent.velocity + parent.omega * perp(arm);
    state.bias = parent.bias - (parent.omega * parent.omega) * arm;
    twist.base = -perp(state.origin);
    return;
  }
  Vec2 arm = parent.rotation * link.position;
  Rotation frame = parent.rotation;
  if (link.angle != 0.0) frame = frame * link.base;
  if (link.kind == LinkKind::kStation) arm += frame * Vec2{link.station, 0.0};
  double turn_rate = 0.0;
  Vec2 relative_velocity{};
  for (const int index : link.motions) {
    const Motion& motion = m_->motions[as_index(index)];
    const std::size_t k = as_index(motion.coordinate);
    turn_rate += motion.rho * v_[k];
    const Vec2 t = frame * motion.translation;
    translation_[as_index(index)] = t;
    translation_rate_[as_index(index)] = parent.omega * perp(t);
    arm += q_[k] * t;
    relative_velocity += v_[k] * t;
  }
  state.origin = parent.origin + arm;
  state.rotation = frame * own;
  state.omega = parent.omega + turn_rate;
  state.velocity = parent.velocity + parent.omega * perp(arm) + relative_velocity;
  state.bias = parent.bias - (parent.omega * parent.omega) * arm +
               (2.0 * parent.omega) * perp(relative_velocity);
  for (const int index : link.motions) {
    Twist& twist = twist_[as_index(index)];
    twist.base = translation_[as_index(index)] - twist.rho * perp(state.origin);
  }
}

void Dynamics::move_links(std::span<const double> q, std::span<const double> v) {
  std::copy(q.begin(), q.end(), q_.begin());
  std::copy(v.begin(), v.end(), v_.begin());
  for (const std::size_t i : moving_) move_link(i);
}

void Dynamics::move_lumps() {
  for (std::size_t i = 1; i < links_.size(); ++i) {
    if (m_->links[i].lump) move_link(i);
  }
}

void Dynamics::locate_contact(std::size_t i, const MechanicalState& at_state, const Drive& drive,
                              Detail detail) {
  const Contact& contact = m_->contacts[i];
  ContactState& state = contacts_[i];
  const LinkState& a = links_[as_index(contact.a.link)];
  const LinkState& b = links_[as_index(contact.b.link)];
  const bool grounded = contact.a.link == 0;
  const Vec2 center = b.origin + b.rotation * contact.b.local;
  const Vec2 base = grounded ? contact.a.local : a.origin + a.rotation * contact.a.local;
  const Vec2 d = center - base;
  const auto leave_open = [&state](double compression) {
    state.compression = compression;
    state.closed = false;
  };
  if (detail == Detail::kClosedContacts && contact.string_contact < 0 && !contact.finger) {
    // Most contacts are open, and then nothing but the gap is wanted.
    const double gap = quick_gap(contact, grounded, a.rotation, d);
    if (gap >= 0.0) return leave_open(-gap);
  }
  state.center = center;
  state.turning_normal = false;
  state.part = 0;
  state.curvature = 0.0;
  double compression = Surface{contact, a.rotation, base, d, state}.compression();

  const bool active = contact.finger ? drive.kind == InputKind::kMotion : contact.enabled;
  double extra_rate = 0.0;
  if (contact.string_contact >= 0) {
    const AttachedString& attached =
        m_->string_of(m_->string_contacts[as_index(contact.string_contact)]);
    if (strings_apart_) return leave_open(compression);
    const auto own =
        at_state.eta.subspan(as_index(attached.offset), as_index(attached.string.modes()));
    // No string reaches further than the sum of its modes: far from it the shapes are not needed.
    if (detail == Detail::kClosedContacts &&
        compression + attached.string.largest_displacement(own) <= 0.0) {
      return leave_open(compression);
    }
    locate_string(contact, state, d, at_state);
    compression -= state.string.displacement;
    extra_rate = -state.string.velocity - state.string.slope * state.strike_speed;
  }
  if (contact.finger) {
    compression += drive.displacement;
    extra_rate = drive.speed;
  }

  state.compression = compression;
  state.closed = active && compression > 0.0;
  if (!state.closed && detail == Detail::kClosedContacts) return;
  state.point = center - (contact.radius_b - 0.5 * compression) * state.normal;
  state.relative_velocity = b.velocity + b.omega * perp(state.point - b.origin);
  if (!grounded) {
    state.relative_velocity -= a.velocity + a.omega * perp(state.point - a.origin);
  }
  state.rate = extra_rate - dot(state.normal, state.relative_velocity);
  state.slip = dot(perp(state.normal), state.relative_velocity);
}

void Dynamics::locate_string(const Contact& contact, ContactState& state, Vec2 d,
                             const MechanicalState& at_state) {
  const StringContact& touch = m_->string_contacts[as_index(contact.string_contact)];
  const AttachedString& attached = m_->string_of(touch);
  const LinkState& b = links_[as_index(contact.b.link)];
  const Vec2 along = touch.sense * perp(state.normal);
  const std::size_t offset = as_index(attached.offset);
  const std::size_t modes = as_index(attached.string.modes());
  state.strike_gradient = touch.moving ? along : Vec2{};
  state.strike_position = touch.moving ? touch.anchor + dot(along, d) : touch.position;
  const std::span<double> phi{phi_.data() + touch.shape, modes};
  const std::span<double> dphi{dphi_.data() + touch.shape, modes};
  double& shaped = shaped_at_[as_index(contact.string_contact)];
  if (state.strike_position != shaped) {
    attached.string.shapes(state.strike_position, phi, dphi);
    if (touch.side < 0.0) {
      for (double& p : phi) p = -p;
      for (double& p : dphi) p = -p;
    }
    shaped = state.strike_position;
  }
  state.string = attached.string.point(phi, dphi, at_state.eta.subspan(offset, modes),
                                       at_state.eta_rate.subspan(offset, modes));
  const Vec2 center_velocity = b.velocity + b.omega * perp(state.center - b.origin);
  state.strike_speed = dot(state.strike_gradient, center_velocity);
}

void Dynamics::locate_only(const MechanicalState& state, const Drive& drive,
                           std::span<const std::size_t> contacts) {
  std::copy(state.q.begin(), state.q.end(), q_.begin());
  std::copy(state.v.begin(), state.v.end(), v_.begin());
  std::copy(state.law.begin(), state.law.end(), law_.begin());
  for (const std::size_t i : contacts) {
    if (m_->contacts[i].finger && drive.kind != InputKind::kMotion) continue;
    for (const int link : carriers_[i]) move_link(as_index(link));
    locate_contact(i, state, drive, Detail::kAllContacts);
  }
}

void Dynamics::locate(const MechanicalState& state, const Drive& drive, Detail detail) {
  move_links(state.q, state.v);
  std::copy(state.law.begin(), state.law.end(), law_.begin());
  for (std::size_t i = 0; i < contacts_.size(); ++i) {
    if (m_->contacts[i].finger && drive.kind != InputKind::kMotion) {
      contacts_[i].closed = false;
      continue;
    }
    locate_contact(i, state, drive, detail);
  }
}

}  // namespace feltmb
