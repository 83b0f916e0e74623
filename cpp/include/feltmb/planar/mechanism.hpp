/// An assembled mechanism: immutable, shared between threads.
#pragma once

#include <Eigen/Dense>
#include <algorithm>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "feltmb/planar/description.hpp"
#include "feltmb/planar/play.hpp"

namespace feltmb {

/// Contact travel to which the coordinate scales refer [m].
inline constexpr double kFeltTravel = 1e-3;

/// A point fixed to a link.
struct LinkPoint {
  int link = 0;
  Vec2 local;
};

/// Position of the frame of a body in its link.
struct Placement {
  int link = 0;
  Vec2 offset;
  double angle = 0.0;
  int beam = -1;  ///< index of the flexible beam that the body is, -1 if rigid
};

/// Way in which one coordinate moves the links beyond a joint or a station of a beam: a material
/// point p gets the velocity t + rho perp(p - c) a unit of coordinate rate, c the link's origin.
struct Motion {
  int coordinate = 0;
  int link = 0;      ///< link whose origin is c and whose parent carries t
  Vec2 translation;  ///< t in the frame of the joint on the parent: axis or (U, V)
  double rho = 0.0;  ///< 1 (revolute), 0 (prismatic), dV/dx (station)
  int group = 0;     ///< first coordinate of the joint or beam
};

enum class LinkKind { kGround, kRevolute, kPrismatic, kStation };

/// A moving rigid frame after welds have been merged; link 0 is the ground. A station is a cross
/// section of a flexible beam, with the bodies welded to it, or a lump of the beam's own mass.
struct Link {
  std::string name;  ///< name of the body that carries the joint
  int parent = -1;   ///< link index; -1 for the ground itself
  LinkKind kind = LinkKind::kGround;
  Vec2 position;             ///< joint, or base of the beam, on the parent link [m]
  Rotation base;             ///< rotation of the joint frame against the parent
  double angle = 0.0;        ///< angle of the same [rad]
  double station = 0.0;      ///< station: x along the undeformed beam [m]
  bool lump = false;         ///< station: a lump of the beam's mass, whose turning is left out
  double mass = 0.0;         ///< [kg]
  Vec2 center_of_mass;       ///< [m]
  double inertia = 0.0;      ///< about the center of mass [kg m^2]
  std::vector<int> motions;  ///< of its own joint or station
  std::vector<int> path;     ///< motions that move the link, from the root outward
};

/// Elastic coordinates of a flexible beam and their constant stiffness.
///
/// Axial modes are an order of magnitude faster (6 to 8 kHz in the upright action) than all that
/// matters, and would hold the step of a multistep method down. With `condense_axial` a simulation
/// keeps them at their rest value while it moves the mechanism, and finds them from their own
/// equation without inertia, K_uu (u - u_rest) = Q_u - M_ur a_r: the first term of an expansion in
/// 1 / (E A). Evaluation and equilibrium always use all coordinates.
struct FlexibleBeam {
  std::string name;
  int first = 0;  ///< first coordinate
  int count = 0;
  Eigen::MatrixXd stiffness;  ///< K [N/m]
  double damping_time = 0.0;  ///< beta [s]
  Placement base;             ///< where its frame sits
  BeamShapes shapes;
  double length = 0.0;
  bool condense_axial = true;

  // Integrals of the mass over the centerline d = (x, 0) + sum S_k e_k in the beam's frame. They
  // give the same as the lumps, which stand at Gauss points, in a fraction of the time; the exact
  // derivatives use the lumps.
  double mass = 0.0;               ///< of the beam [kg]
  double first_moment = 0.0;       ///< of x [kg m]
  double second_moment = 0.0;      ///< of x^2 [kg m^2]
  std::vector<Vec2> shape_moment;  ///< of S_k [kg]
  std::vector<double> radial;      ///< of x S_k,x [kg m]
  std::vector<double> transverse;  ///< of x S_k,y [kg m]
  Eigen::MatrixXd shape_product;   ///< of S_k . S_l [kg]
  Eigen::MatrixXd shape_cross;     ///< of S_k x S_l [kg]

  Eigen::MatrixXd axial_at;    ///< U_k at quarters of the length, (4, count) [-]
  Eigen::MatrixXd lateral_at;  ///< V_k there [-]

  /// Largest displacement at the quarters, along or across [m], for the elastic coordinates e.
  double deflection(std::span<const double> e) const {
    const Eigen::Map<const Eigen::VectorXd> of(e.data(), count);
    return std::max((axial_at * of).cwiseAbs().maxCoeff(), (lateral_at * of).cwiseAbs().maxCoeff());
  }
};

/// Flat side of a contact pair: every pair of surfaces reduces to a circle on link b against one
/// of these on link a.
enum class PairKind {
  kLineCircle,
  kCircleCircle,
  kConcaveCircle,
  kHybridCircle,
  kSegmentCircle,
  kConcaveArcCircle,
};

struct Contact {
  int number = 0;
  std::string name;  ///< "contact01"
  std::string label;
  PairKind kind = PairKind::kLineCircle;
  LinkPoint a;    ///< point of the line or center of the circle on link a
  Vec2 normal_a;  ///< line: local normal out of the material
  double radius_a = 0.0;
  Vec2 arc_normal[2];  ///< hybrid: local normals of the two half-lines
  Vec2
      arc_tangent[2];  ///< hybrid, segment, concave arc: local directions that leave it at its ends
  Vec2 end[2];         ///< segment, concave arc: its ends, from `a`, local
  bool more_than_half = false;  ///< concave arc: spans more than pi
  LinkPoint b;                  ///< center of the circle on link b
  double radius_b = 0.0;
  bool swapped = false;  ///< the description named the circle first
  ContactLaw law;
  Friction friction;
  bool enabled = true;
  int string_contact = -1;       ///< index in Mechanism::string_contacts, -1 if no string
  bool finger = false;           ///< line a moves with the prescribed finger motion
  std::vector<int> coordinates;  ///< union of the paths of a and b, ascending
  int first_state = 0;           ///< of the law, in the concatenated law states
};

struct Dashpot {
  int coordinate = 0;
  double coefficient = 0.0;
  int side = 0;

  /// Force against a motion of rate v, and its slope.
  FrictionValue against(double v) const {
    const bool acts = side == 0 || v * side > 0.0;
    return acts ? FrictionValue{coefficient * v, coefficient} : FrictionValue{0.0, 0.0};
  }
};

struct TorsionSpring {
  std::string name;
  int coordinate = 0;
  double stiffness = 0.0;
  double rest_angle = 0.0;
  Play play;  ///< its damping is part of the friction of the coordinate
};

struct Strap {
  std::string name;
  LinkPoint a;
  LinkPoint b;
  double free_length = 0.0;
  std::array<double, 3> coefficients{};
  double slack = 0.0;  ///< elongation up to which the clamped cubic is zero [m]
  std::vector<int> coordinates;

  /// Force on end a where end b lies `d` from it [N].
  Vec2 pull(Vec2 d) const {
    const double taut = free_length + std::max(0.0, slack);
    if (dot(d, d) <= taut * taut) return {};
    const double distance = norm(d);
    const double e = distance - free_length;
    const auto [k1, k2, k3] = coefficients;
    return (e * (k1 + e * (k2 + e * k3)) / distance) * d;
  }
};

struct AttachedString {
  std::string name;
  ModalString string;
  int offset = 0;         ///< first mode in the concatenated modal coordinates
  int first_contact = 0;  ///< in Mechanism::string_contacts: what strikes it; others follow
  int contacts = 0;       ///< how many touch it
};

/// Position and side at which a contact touches a string.
struct StringContact {
  int string = -1;        ///< index in Mechanism::strings
  int contact = -1;       ///< index in Mechanism::contacts
  double anchor = 0.0;    ///< distance of its line's point from the string's end y = 0 [m]
  double sense = 1.0;     ///< y grows along sense * (normal turned by +90 degrees)
  double side = 1.0;      ///< -1: it presses against the positive sense of the displacement
  bool moving = true;     ///< the point follows the body along the string
  double position = 0.0;  ///< y of a point that does not move [m]
  int shape = 0;          ///< first of its mode shapes in the concatenated ones
};

struct TrackingPoint {
  std::string name;
  LinkPoint point;
};

/// Everything that the equations of motion need, checked once. Made by `assemble`.
class Mechanism {
 public:
  std::string name;
  Vec2 gravity;
  std::vector<Link> links;                ///< parents before children; links[0] is the ground
  std::vector<std::string> coordinates;   ///< names in the order of q
  std::vector<bool> coordinate_is_angle;  ///< unit rad, else m
  std::vector<Motion> motions;
  std::vector<FlexibleBeam> beams;
  std::vector<int> coordinate_parent;    ///< next coordinate toward the root, -1 at a root
  std::vector<Friction> joint_friction;  ///< by coordinate
  std::vector<Contact> contacts;         ///< described contacts, then the finger pad if any
  std::vector<TorsionSpring> springs;
  std::vector<Dashpot> dashpots;
  std::vector<Strap> straps;
  std::vector<AttachedString> strings;
  std::vector<StringContact> string_contacts;  ///< those of one string together
  std::vector<TrackingPoint> points;
  std::vector<std::pair<std::string, Placement>> bodies;  ///< every described body
  std::vector<double> start_pose;                         ///< by coordinate
  std::vector<double> coordinate_scale;  ///< coordinate change that moves a contact by kFeltTravel
  int finger_contact = -1;               ///< index in contacts, -1 without a finger
  LinkPoint finger_point;
  Vec2 finger_direction{0.0, -1.0};
  int motor_coordinate = -1;  ///< index of the coordinate a motor drives, -1 without a motor
  int motor_contact = -1;     ///< index of the contact that is the motor's finger, -1 if none
  int total_modes = 0;
  int total_shapes = 0;  ///< modes counted once for each contact with their string
  int total_law_states = 0;

  int size() const { return static_cast<int>(coordinates.size()); }

  std::span<const StringContact> contacts_of(const AttachedString& s) const {
    return std::span<const StringContact>(string_contacts)
        .subspan(static_cast<std::size_t>(s.first_contact), static_cast<std::size_t>(s.contacts));
  }
  /// The string that a contact touches; it must touch one.
  const AttachedString& string_of(const StringContact& c) const {
    return strings[static_cast<std::size_t>(c.string)];
  }

  /// Index of a named coordinate, contact ("contact01") or tracking point; -1 if there is none.
  int coordinate_index(const std::string& coordinate) const;
  int contact_index(int number) const;
  int point_index(const std::string& point) const;
};

/// Checks a description and assembles it. Throws InvalidParameter that lists all faults at once:
/// names that are missing or twice given, bodies in a loop, masses that leave a coordinate without
/// inertia, surfaces that cannot meet, law parameters out of range.
std::shared_ptr<const Mechanism> assemble(const MechanismDescription& description);

}  // namespace feltmb
