/// Plain data that describes a planar mechanism. `assemble` turns it into a Mechanism.
///
/// SI units throughout; angles in rad, counterclockwise positive. Body "ground" is the inertial
/// frame. Points and directions are given in the frame of the body that carries them.
#pragma once

#include <array>
#include <optional>
#include <string>
#include <vector>

#include "feltmb/beam/shapes.hpp"
#include "feltmb/contact/friction.hpp"
#include "feltmb/contact/law.hpp"
#include "feltmb/core/fields.hpp"
#include "feltmb/core/vec2.hpp"
#include "feltmb/modal/string.hpp"

namespace feltmb {

enum class JointKind {
  kRevolute,   ///< coordinate: angle relative to the parent [rad]
  kPrismatic,  ///< coordinate: displacement along `axis` of the parent [m]
  kWeld,       ///< no coordinate
};

/// Elastic data of a body that is a uniform flexible beam along its x axis, clamped at its origin.
///
/// Euler-Bernoulli, small deflections: a point (x, y) of the beam moves to
/// (x + u(x), v(x)) + R(v'(x)) (0, y); no rotary inertia, shear or foreshortening. Bodies,
/// surfaces and points fixed to the beam follow its centerline at their x.
struct BeamDescription {
  double length = 0.0;             ///< L [m], > 0
  double linear_density = 0.0;     ///< rho A [kg/m], > 0
  double axial_stiffness = 0.0;    ///< E A [N], > 0
  double bending_stiffness = 0.0;  ///< E I [N m^2], > 0
  ShapeSet shapes = ShapeSet::kPolynomial;
  int axial_shapes = 1;        ///< number of axial coordinates, >= 0 (0: inextensible)
  int lateral_shapes = 2;      ///< number of lateral coordinates, >= 1
  double damping_time = 0.0;   ///< stiffness-proportional damping beta [s], >= 0: -beta K de/dt
  bool condense_axial = true;  ///< in time: axial coordinates follow statically, see FlexibleBeam

  static constexpr auto fields() {
    using S = BeamDescription;
    return std::tuple{
        number("length", &S::length, "m", above(0.0), "L"),
        number("linear_density", &S::linear_density, "kg/m", above(0.0), "rho A"),
        number("axial_stiffness", &S::axial_stiffness, "N", above(0.0), "E A"),
        number("bending_stiffness", &S::bending_stiffness, "N m^2", above(0.0), "E I"),
        entry("shapes", &S::shapes, "set of shapes"),
        count("axial_shapes", &S::axial_shapes, at_least(0.0),
              "axial coordinates; 0: inextensible"),
        count("lateral_shapes", &S::lateral_shapes, at_least(1.0), "lateral coordinates"),
        number("damping_time", &S::damping_time, "s", at_least(0.0),
               "beta of the damping -beta K de/dt"),
        entry("condense_axial", &S::condense_axial, "axial coordinates follow statically"),
    };
  }
};

/// A rigid body or flexible beam and the joint that ties its origin to its parent.
struct BodyDescription {
  std::string name;
  std::string parent = "ground";
  JointKind joint = JointKind::kRevolute;
  Vec2 position;           ///< joint on the parent [m]
  Vec2 axis{0.0, 1.0};     ///< prismatic only: direction in the parent frame, unit length
  double angle = 0.0;      ///< angle of the body against the parent at coordinate zero [rad]
  std::string coordinate;  ///< name of the joint coordinate; empty for a weld
  Friction friction;       ///< of the joint, amplitude in N m (revolute) or N (prismatic)
  double mass = 0.0;       ///< [kg], >= 0
  Vec2 center_of_mass;     ///< [m]
  double inertia = 0.0;    ///< about the center of mass [kg m^2], >= 0
  std::optional<BeamDescription> beam;  ///< a flexible beam: its own mass comes from here only

  static constexpr auto fields() {
    using S = BodyDescription;
    return std::tuple{
        entry("name", &S::name, "of the body"),
        entry("parent", &S::parent, "body that carries it"),
        entry("joint", &S::joint, "to the parent"),
        entry("position", &S::position, "joint on the parent [m]"),
        entry("axis", &S::axis, "of a prismatic joint"),
        number("angle", &S::angle, "rad", any_number(), "against the parent at coordinate zero"),
        entry("coordinate", &S::coordinate, "of the joint"),
        entry("friction", &S::friction, "of the joint"),
        number("mass", &S::mass, "kg", at_least(0.0), "of the body"),
        entry("center_of_mass", &S::center_of_mass, "[m]"),
        number("inertia", &S::inertia, "kg m^2", at_least(0.0), "about the center of mass"),
        entry("beam", &S::beam, "a flexible beam"),
    };
  }
};

enum class SurfaceKind {
  kLine,     ///< through `point`, infinite; `normal` points out of the material
  kCircle,   ///< full circle about `point`, material inside
  kConcave,  ///< full circle about `point`, material outside: holds the other circle inside
  kHybrid,   ///< arc about `point` from arc[0] to arc[1] with its two tangent half-lines
  /// From `point` to `end`, material on the right of the way; with `radius` a bar of that thickness
  /// about it. Beyond an end that end is touched, from all sides.
  kSegment,
  /// The concave circle from arc[0] to arc[1] only. Beyond an end that end is touched.
  kConcaveArc,
};

/// A contact surface fixed to a body.
struct SurfaceDescription {
  std::string name;
  std::string body;
  SurfaceKind kind = SurfaceKind::kCircle;
  Vec2 point;             ///< point of the line or center of the circle [m]
  Vec2 normal{0.0, 1.0};  ///< line only, unit length
  double radius = 0.0;    ///< circles, hybrid, segment [m], >= 0 (0: a point)
  /// Hybrid and concave arc: angles of the arc's ends, counterclockwise [rad].
  std::array<double, 2> arc{0.0, 0.0};
  Vec2 end{};  ///< segment only [m]

  static constexpr auto fields() {
    using S = SurfaceDescription;
    return std::tuple{
        entry("name", &S::name, "of the surface"),
        entry("body", &S::body, "that carries it"),
        entry("kind", &S::kind, "of the surface"),
        entry("point", &S::point, "of the line, or center [m]"),
        entry("normal", &S::normal, "of a line"),
        number("radius", &S::radius, "m", at_least(0.0),
               "of circle or arc, half the thickness of a segment; 0: a point"),
        entry("arc", &S::arc, "angles of its ends [rad]"),
        entry("end", &S::end, "of a segment [m]"),
    };
  }
};

/// A pair of surfaces that meet through felt or leather.
struct ContactDescription {
  int number = 0;     ///< as in thesis Table 4.2; names outputs (contact01, ...)
  std::string label;  ///< for people
  std::string surface_a;
  std::string surface_b;
  LawParameters law;
  Friction friction;  ///< amplitude without unit
  bool enabled = true;

  static constexpr auto fields() {
    using S = ContactDescription;
    return std::tuple{
        entry("number", &S::number, "names outputs"),
        entry("label", &S::label, "for people"),
        entry("surface_a", &S::surface_a, "one side"),
        entry("surface_b", &S::surface_b, "the other"),
        entry("law", &S::law, "of the normal force"),
        entry("friction", &S::friction, "of the contact"),
        entry("enabled", &S::enabled, "whether it acts"),
    };
  }
};

/// Spring on a joint coordinate: torque [N m] or force [N]
///   -K (q - q_0) - C dq/dt - R x / (w - |x|),  x = q - q_0.
/// The last term is play: a pin in a hole of radial clearance w that a load of about R seats
/// against the wall. Its stiffness is R / w in the middle and grows without bound toward the wall
/// (continued linearly beyond 0.99 w, so that trial steps stay finite).
struct TorsionSpringDescription {
  std::string name;
  std::string coordinate;
  double stiffness = 0.0;   ///< K [N m/rad], >= 0
  double rest_angle = 0.0;  ///< q_0 [rad or m]
  double damping = 0.0;     ///< C [N m s/rad or N s/m], >= 0
  double clearance = 0.0;   ///< w [rad or m], >= 0; 0: no play
  double seating = 0.0;     ///< R [N m or N], > 0 with play

  static constexpr auto fields() {
    using S = TorsionSpringDescription;
    return std::tuple{
        entry("name", &S::name, "of the spring"),
        entry("coordinate", &S::coordinate, "of a joint"),
        number("stiffness", &S::stiffness, "N m/rad | N/m", at_least(0.0), "K"),
        number("rest_angle", &S::rest_angle, "rad | m", any_number(), "q_0"),
        number("damping", &S::damping, "N m s/rad | N s/m", at_least(0.0), "C"),
        number("clearance", &S::clearance, "rad | m", at_least(0.0), "w of the play; 0: none"),
        number("seating", &S::seating, "N m | N", at_least(0.0), "R of the play"),
    };
  }
};

/// Dashpot between a joint's two bodies: torque or force -c v on its coordinate.
struct DashpotDescription {
  std::string name;
  std::string coordinate;
  double coefficient = 0.0;  ///< c [N m s/rad or N s/m], >= 0
  int side = 0;              ///< 0: always; +1 or -1: only while v has this sign

  static constexpr auto fields() {
    using S = DashpotDescription;
    return std::tuple{
        entry("name", &S::name, "of the dashpot"),
        entry("coordinate", &S::coordinate, "of a joint"),
        number("coefficient", &S::coefficient, "N m s/rad | N s/m", at_least(0.0), "c"),
        entry("side", &S::side, "0: both; +1, -1: of this motion"),
    };
  }
};

/// One-sided strap, thesis eq. 4.5: pull f(D) = k3 D^3 + k2 D^2 + k1 D of elongation
/// D = distance - free_length, held at >= 0; zero when slack.
struct StrapDescription {
  std::string name;
  std::string body_a;
  Vec2 point_a;
  std::string body_b;
  Vec2 point_b;
  double free_length = 0.0;                           ///< [m], > 0
  std::array<double, 3> coefficients{0.0, 0.0, 0.0};  ///< k1 [N/m], k2 [N/m^2], k3 [N/m^3]

  static constexpr auto fields() {
    using S = StrapDescription;
    return std::tuple{
        entry("name", &S::name, "of the strap"),
        entry("body_a", &S::body_a, "one end"),
        entry("point_a", &S::point_a, "[m]"),
        entry("body_b", &S::body_b, "the other"),
        entry("point_b", &S::point_b, "[m]"),
        number("free_length", &S::free_length, "m", above(0.0), "where it starts to pull"),
        entry("coefficients", &S::coefficients, "k1 [N/m], k2 [N/m^2], k3 [N/m^3]"),
    };
  }
};

/// A string behind line surfaces of the ground: every contact with one of them touches it.
struct StringDescription {
  std::string name = "string";
  std::string surface;  ///< the line along which the string runs, met by what strikes it
  bool rigid = false;   ///< true: a rigid stop, no modes
  StringParameters parameters;
  double anchor = 0.0;        ///< distance of the first line's point from the end y = 0 [m]
  Vec2 direction{0.0, -1.0};  ///< sense of increasing y in the ground frame
  /// Points of contact follow the bodies along the string. Else that of `surface` is held at
  /// `strike_position`, those of the others at the points of their lines.
  bool moving_strike_point = true;
  double strike_position = 0.0;  ///< y of a strike point that does not move [m]
  /// More lines along the same string, such as a damper's; each may face either way.
  std::vector<std::string> other_surfaces;

  static constexpr auto fields() {
    using S = StringDescription;
    return std::tuple{
        entry("name", &S::name, "of the string"),
        entry("surface", &S::surface, "line along which it runs"),
        entry("rigid", &S::rigid, "a stop without modes"),
        entry("parameters", &S::parameters, "of the modes"),
        number("anchor", &S::anchor, "m", any_number(), "distance of the line's point from y = 0"),
        entry("direction", &S::direction, "of increasing y"),
        entry("moving_strike_point", &S::moving_strike_point, "follows the striker"),
        entry("other_surfaces", &S::other_surfaces, "more lines along it"),
        number("strike_position", &S::strike_position, "m", any_number(),
               "y of a fixed strike point"),
    };
  }
};

/// A named point of a body whose motion is an output.
struct TrackingPointDescription {
  std::string name;
  std::string body;
  Vec2 point;

  static constexpr auto fields() {
    using S = TrackingPointDescription;
    return std::tuple{
        entry("name", &S::name, "of the point"),
        entry("body", &S::body, "that carries it"),
        entry("point", &S::point, "[m]"),
    };
  }
};

/// Point at which the player's finger acts on the mechanism.
struct FingerDescription {
  std::string body;
  Vec2 point;
  Vec2 direction{0.0, -1.0};  ///< in the ground frame, positive sense of force and motion
  LawParameters pad;          ///< to be given

  static constexpr auto fields() {
    using S = FingerDescription;
    return std::tuple{
        entry("body", &S::body, "under the finger"),
        entry("point", &S::point, "[m]"),
        entry("direction", &S::direction, "of force and motion"),
        entry("pad", &S::pad, "law between finger and body"),
    };
  }
};

/// A motor on a joint coordinate that drives the mechanism instead of a finger.
struct MotorDescription {
  std::string coordinate;
  int contact = 0;  ///< number of the contact that is its finger on the key; 0: none

  static constexpr auto fields() {
    using S = MotorDescription;
    return std::tuple{
        entry("coordinate", &S::coordinate, "of a revolute joint"),
        entry("contact", &S::contact, "that is its finger; 0: none"),
    };
  }
};

struct MechanismDescription {
  std::string name;
  Vec2 gravity{0.0, -9.81};  ///< [m/s^2]
  std::vector<BodyDescription> bodies;
  std::vector<SurfaceDescription> surfaces;
  std::vector<ContactDescription> contacts;
  std::vector<TorsionSpringDescription> springs;
  std::vector<DashpotDescription> dashpots;
  std::vector<StrapDescription> straps;
  std::vector<StringDescription> strings;
  std::vector<TrackingPointDescription> points;
  std::optional<FingerDescription> finger;
  std::optional<MotorDescription> motor;
  /// Start of the equilibrium solve by coordinate name; missing ones are zero. Not a rest pose.
  std::vector<std::pair<std::string, double>> start_pose;

  static constexpr auto fields() {
    using S = MechanismDescription;
    return std::tuple{
        entry("name", &S::name, "of the mechanism"),
        entry("gravity", &S::gravity, "[m/s^2]"),
        entry("bodies", &S::bodies, ""),
        entry("surfaces", &S::surfaces, ""),
        entry("contacts", &S::contacts, ""),
        entry("springs", &S::springs, ""),
        entry("dashpots", &S::dashpots, ""),
        entry("straps", &S::straps, ""),
        entry("strings", &S::strings, ""),
        entry("points", &S::points, "tracking points"),
        entry("finger", &S::finger, "optional"),
        entry("motor", &S::motor, "optional"),
        entry("start_pose", &S::start_pose, "by coordinate"),
    };
  }
};

}  // namespace feltmb
