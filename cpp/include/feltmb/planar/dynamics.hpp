/// Equations of motion of an assembled mechanism and their exact derivatives.
#pragma once

#include <Eigen/Dense>
#include <memory>
#include <span>
#include <vector>

#include "feltmb/planar/mechanism.hpp"

namespace feltmb {

/// Kind of the input that drives a mechanism.
enum class InputKind {
  kForce,        ///< a finger presses with a force [N]
  kMotion,       ///< a finger moves, its pad lies in between [m]
  kKeyMotion,    ///< the point under the finger keeps to a motion, whatever force that takes [m]
  kTorque,       ///< a motor turns its coordinate by a torque [N m]
  kMotorMotion,  ///< its coordinate keeps to a motion, whatever torque that takes [rad]
};

constexpr bool is_prescribed(InputKind kind) {
  return kind == InputKind::kKeyMotion || kind == InputKind::kMotorMotion;
}
constexpr bool is_of_motor(InputKind kind) {
  return kind == InputKind::kTorque || kind == InputKind::kMotorMotion;
}
constexpr bool is_motion(InputKind kind) {
  return kind == InputKind::kMotion || is_prescribed(kind);
}

/// "force", "motion", "key_motion", "torque" or "motor_motion"; throws InvalidParameter.
InputKind input_kind(const std::string& name);
const char* input_name(InputKind kind);

/// External input of the mechanism at one time.
struct Drive {
  InputKind kind = InputKind::kForce;
  double force = 0.0;         ///< along the finger direction [N], or torque [N m]
  double displacement = 0.0;  ///< of a motion, along the finger direction [m], or angle [rad]
  double speed = 0.0;         ///< its rate [m/s, rad/s]
  double acceleration = 0.0;  ///< rate of the speed [m/s^2, rad/s^2], of a prescribed motion
  int coordinate = -1;        ///< of the motor
};

/// Prescribed motion g(q) = displacement(t) as one equation for the reaction R along it:
/// M a = Q + J^T R, J = dg/dq, and d2/dt2 + 2 c d/dt + c^2 of (g - displacement) = 0 with the
/// stabilization rate c (J. Baumgarte 1972), which keeps rounding and step errors from growing.
struct Prescription {
  static constexpr double rate = 300.0;  ///< c [1/s]
  bool active = false;
  double reaction = 0.0;        ///< R [N, N m]
  Eigen::VectorXd row;          ///< J; zero for condensed coordinates
  Eigen::VectorXd by_position;  ///< derivative of the equation by q at fixed a, after differentiate
  Eigen::VectorXd by_speed;     ///< by v
};

/// Motion of a link frame.
struct LinkState {
  Vec2 origin;
  Rotation rotation;
  Vec2 velocity;  ///< of the origin
  double omega = 0.0;
  Vec2 bias;          ///< acceleration of the origin for zero coordinate accelerations
  Vec2 acceleration;  ///< of the origin
  double alpha = 0.0;
};

/// One contact at one instant. Signs: compression > 0 when touching; slip is the tangential
/// velocity of b against a along the normal turned by +90 degrees; friction_force acts on b
/// along the same direction.
struct ContactState {
  bool closed = false;
  double compression = 0.0;  ///< [m], negative: the gap
  double rate = 0.0;         ///< [m/s]
  LawValue law;              ///< normal force [N] and slopes
  double slip = 0.0;         ///< [m/s]
  FrictionValue friction{0.0, 0.0};
  Vec2 normal;                   ///< unit, out of a, into b
  Vec2 point;                    ///< middle of the overlap [m]
  Vec2 relative_velocity;        ///< of b against a at the point
  Vec2 center;                   ///< center of the circle of b
  Vec2 base;                     ///< about which the normal turns
  int part = 0;                  ///< of the surface: line 0, circle 1, first end 2, second end 3
  bool turning_normal = false;   ///< normal follows the line between two centers
  double curvature = 0.0;        ///< 1 / distance of the centers, for circle pairs [1/m]
  StringPoint string;            ///< string at the point of contact, as it yields to the contact
  double strike_position = 0.0;  ///< y along the string [m]
  double strike_speed = 0.0;     ///< dy/dt [m/s]
  Vec2 strike_gradient;          ///< d y / d (center of b), zero if the point is held
};

/// Derivative of the generalized force of one closed contact, split so that the slopes of the law
/// enter last: dQ = b dF + c de + (rest, in the stiffness and damping matrices).
struct ContactGradient {
  int contact = -1;
  bool exact = false;              ///< by differentiate(); else all but two vectors are zero
  Eigen::VectorXd by_force;        ///< b = dQ/dF
  Eigen::VectorXd by_compression;  ///< c = dQ/de at fixed force
  Eigen::VectorXd compression;     ///< de/dq
  Eigen::VectorXd rate;            ///< d(de/dt)/dq
  Eigen::VectorXd strike;          ///< dy/dq of the strike point
  Eigen::VectorXd by_slope;        ///< dQ/d(F x slope of the string): strike, as a force
};

/// State of a mechanism with its contact laws and strings.
struct MechanicalState {
  std::span<const double> q;         ///< coordinates [rad, m]
  std::span<const double> v;         ///< their rates
  std::span<const double> law;       ///< states of the contact laws, concatenated
  std::span<const double> eta;       ///< modal coordinates of all strings [m kg^1/2]
  std::span<const double> eta_rate;  ///< their rates
};

/// Requested data of the contacts: for an open contact, only its compression is needed.
enum class Detail { kClosedContacts, kAllContacts };

/// Mutable workspace that evaluates one mechanism; one a thread.
///
/// M(q) a = Q(q, v, t): planar tree of links in relative coordinates, rigid or stations of flexible
/// beams. A coordinate k moves a material point p of a link beyond it with the velocity
/// t_k + rho_k perp(p - c_k), perp = +90 degrees (revolute: t = 0, rho = 1, c the pivot; prismatic:
/// t the axis, rho = 0; elastic: t the shape at the station c, rho its slope). With absolute
/// coordinates x(q) the identities dx'/dq = J', dx''/dq = J'' (total time derivatives) give the
/// exact derivatives of the inertial forces. Cost: O(links x depth of the tree^2).
class Dynamics {
 public:
  explicit Dynamics(std::shared_ptr<const Mechanism> mechanism);

  const Mechanism& mechanism() const { return *m_; }

  /// From now on, keeps the axial coordinates of beams with `condense_axial` constant.
  void condense_axial();

  /// Adds the deflection of the kept coordinates from their kept values [m], from their equations
  /// without their own inertia, at the state of the last `evaluate` of all contacts.
  void add_condensed_deflection(std::span<double> q) const;

  /// Evaluates positions, contacts, forces, mass matrix and accelerations at a state.
  void evaluate(const MechanicalState& state, const Drive& drive,
                Detail detail = Detail::kClosedContacts);

  /// Positions, velocities and the geometry of the contacts; no forces.
  void locate(const MechanicalState& state, const Drive& drive,
              Detail detail = Detail::kClosedContacts);

  /// Positions and velocities of the links alone; the contacts stay as they were.
  void place(const MechanicalState& state) { move_links(state.q, state.v); }
  /// The same for these contacts alone, open or closed, and the links that carry them; the others
  /// stay as they are.
  void locate_only(const MechanicalState& state, const Drive& drive,
                   std::span<const std::size_t> contacts);

  /// While set, contacts with strings count as open, and their compression is relative to a string
  /// at rest; modes are not evaluated.
  void set_strings_apart(bool apart) { strings_apart_ = apart; }

  /// From now on, laws are evaluated with their states at rest (equilibrium).
  void use_static_laws() { static_laws_ = true; }

  /// Largest compression that each contact remembers [m], by contact; constant while evaluating.
  std::vector<double>& largest_compression() { return largest_; }
  const std::vector<double>& largest_compression() const { return largest_; }

  /// Turning points of a contact's law, if it has them; constant while evaluating.
  TurningPoints& turns(std::size_t contact) { return turns_[contact]; }

  /// All of the memory between reversals as numbers: the largest compressions by contact, then
  /// pairs of the index of a contact and a turning point [m] of its law.
  std::vector<double> memories() const;
  void set_memories(std::span<const double> memories);

  /// States of a contact's law at the last state given, if it has any.
  const LawStates& law_states(std::size_t contact) const { return law_states_[contact]; }

  /// Rates of the states of all laws at the last state given, concatenated.
  std::span<const double> law_rates() const { return law_rate_; }

  /// Memory of a contact's law at the last state given.
  LawMemory memory(std::size_t contact) const {
    return {law_.data() + m_->contacts[contact].first_state, largest_[contact], &cycles_[contact],
            &turns_[contact]};
  }

  /// Exact derivatives at the state of the last `evaluate`, with the law slopes left out of
  /// stiffness() and damping() for the contacts listed in gradients().
  void differentiate();

  /// The same without what no short step feels: of the forces only those of contacts, members and
  /// friction against their own deformation and speed at fixed geometry, nothing of inertia,
  /// gravity and turning. Time step h: right up to (h omega)^2, omega the rate at which the
  /// mechanism turns and its forces change direction. Contacts with strings are exact. A third of
  /// the time; for Newton's method.
  void differentiate_stiff();

  const Eigen::VectorXd& acceleration() const { return acceleration_; }  ///< a [rad/s^2, m/s^2]
  const Eigen::VectorXd& force() const { return force_; }                ///< Q
  const Eigen::MatrixXd& mass_matrix() const { return mass_; }           ///< M, symmetric

  /// d(Q - M a)/dq and d(Q - M a)/dv at fixed a; see differentiate().
  const Eigen::MatrixXd& stiffness() const { return stiffness_; }
  const Eigen::MatrixXd& damping() const { return damping_; }
  std::span<const ContactGradient> gradients() const {
    return {gradients_.data(), static_cast<std::size_t>(gradient_count_)};
  }

  std::span<const ContactState> contacts() const { return contacts_; }

  /// Fault if a closed contact is beyond the ends of its string; empty if there is none.
  std::string beyond_string() const;

  std::span<const LinkState> links() const { return links_; }

  /// Force of a contact on its string [N], by index in Mechanism::string_contacts; zero if open.
  double string_force(int string_contact) const;

  /// Mode shapes of a string at a point of contact, of the last evaluation, and their slopes: with
  /// the sign of its side, so that shapes times modal coordinates are the way that the string
  /// yields to this contact.
  std::span<const double> phi(int string_contact) const;
  std::span<const double> dphi(int string_contact) const;

  /// Position and velocity of a link point at the last located state.
  Vec2 position(LinkPoint p) const {
    const LinkState& link = links_[static_cast<std::size_t>(p.link)];
    return link.origin + link.rotation * p.local;
  }
  Vec2 velocity(LinkPoint p) const {
    const LinkState& link = links_[static_cast<std::size_t>(p.link)];
    return link.velocity + link.omega * perp(link.rotation * p.local);
  }

  /// Adds to `out` the generalized forces of a force on a link and of its moment about the origin
  /// of the ground frame; links as they were last evaluated, lumps as last differentiated.
  void add_wrench(int link, Vec2 force, double moment, Eigen::VectorXd& out) const;

  /// One contact of this mechanism with the links, states and memory of another workspace, i.e. its
  /// force there. Both mechanisms have the same joints.
  const ContactState& press(std::size_t contact, const Dynamics& at, const MechanicalState& state,
                            const Drive& drive);

  /// The prescribed motion at the last evaluation.
  const Prescription& prescription() const { return prescription_; }

  double strap_force(int strap) const;  ///< pull [N]
  /// With dashpots, against the motion, after evaluate [unit of Q_k].
  double joint_friction(int k) const { return joint_friction_[k]; }
  double beam_damping_power(int beam) const;  ///< dissipated by the structural damping, >= 0 [W]

  double kinetic_energy(std::span<const double> v) const;  ///< of the links [J], after evaluate
  double gravity_energy() const;  ///< [J], zero at the origin of the ground frame
  double spring_energy(std::span<const double> q) const;          ///< torsion springs [J]
  double strap_energy(int strap) const;                           ///< [J]
  double beam_energy(int beam, std::span<const double> q) const;  ///< elastic [J]

  /// Solves M x = b in place with the factors of the last evaluate.
  void solve_mass(Eigen::VectorXd& b) const;

 private:
  struct Wrench {
    Vec2 force;
    double moment = 0.0;  ///< about the origin of the ground frame
    double virial = 0.0;  ///< sum of force . point of application
  };

  void move_links(std::span<const double> q, std::span<const double> v);
  /// Angle of a link's frame against that of its joint [rad].
  double turn(std::size_t i) const;
  void move_link(std::size_t i, Rotation own);
  void move_link(std::size_t i) { move_link(i, Rotation::of(turn(i))); }
  void locate_contact(std::size_t i, const MechanicalState& at_state, const Drive& drive,
                      Detail detail);
  void locate_string(const Contact& contact, ContactState& state, Vec2 d,
                     const MechanicalState& at_state);
  /// A motion seen from the ground: a unit of rate gives a point p the velocity base + rho perp(p).
  struct Twist {
    Vec2 base;
    double rho = 0.0;
    int coordinate = 0;
    int held = 0;  ///< the coordinate is kept
  };

  /// Mass, first moment and moment of inertia about the origin of the ground frame.
  struct Inertia {
    double mass = 0.0;
    Vec2 first;
    double second = 0.0;
  };

  void apply(int link, Vec2 point, Vec2 force) {
    Wrench& w = applied_[static_cast<std::size_t>(link)];
    w.force += force;
    w.moment += cross(point, force);
    w.virial += dot(point, force);
  }
  void keep_law_rates(std::size_t contact);
  void load_contact(std::size_t i);
  void apply_contacts();
  void resist_joints();
  void apply_straps();
  void apply_inertia(std::size_t i);
  void add_beam(std::size_t index);
  void project(std::size_t i);
  void hold_condensed(bool hold);
  void take_out_condensed();
  void prescribe(const Drive& drive);
  void differentiate_prescription();
  void factor_mass();
  void move_lumps();
  /// Lumps and accelerations of all links, for quantities that need each mass separately.
  void complete_links();
  void differentiate_members();
  void release_condensed();
  ContactGradient& next_gradient(std::size_t contact, bool exact);
  void differentiate_contact(std::size_t i);
  void differentiate_stiff_contact(std::size_t i);
  void differentiate_strap(std::size_t i);
  Vec2 column(int motion, Vec2 point) const {
    const Twist& w = twist_[static_cast<std::size_t>(motion)];
    return w.base + w.rho * perp(point);
  }
  Vec2 column_rate(int motion, Vec2 point_velocity) const {
    const auto i = static_cast<std::size_t>(motion);
    const Motion& m = m_->motions[i];
    return translation_rate_[i] +
           m.rho * perp(point_velocity - links_[static_cast<std::size_t>(m.link)].velocity);
  }
  /// Motion by which coordinate k moves a link, -1 if it does not.
  int motion_of(int k, int link) const {
    return motion_of_[static_cast<std::size_t>(link * n_ + k)];
  }
  double rho(int motion) const { return m_->motions[static_cast<std::size_t>(motion)].rho; }

  std::shared_ptr<const Mechanism> m_;
  int n_ = 0;
  std::vector<std::size_t> moving_;  ///< links but the ground and lumps, parents first
  std::vector<LinkState> links_;
  std::vector<Wrench> applied_;
  std::vector<ContactState> contacts_;
  std::vector<std::vector<int>> carriers_;  ///< by contact: links from the ground to both sides
  std::vector<int> motion_of_;              ///< link x coordinate
  std::vector<Vec2> translation_;           ///< t by motion, in the ground frame
  std::vector<Vec2> translation_rate_;
  std::vector<Twist> twist_;  ///< by motion
  std::vector<double> phi_;
  std::vector<double> dphi_;
  std::vector<double> shaped_at_;  ///< position of phi_ by string contact, NaN before the first
  std::vector<double> strap_pull_;
  std::vector<double> strap_slope_;
  Prescription prescription_;
  int driven_coordinate_ = -1;
  Eigen::VectorXd response_;        ///< M^-1 J^T
  std::vector<int> condensed_;      ///< kept coordinates, ascending
  std::vector<char> held_;          ///< by coordinate: whether it is one of them now
  Eigen::MatrixXd condensed_mass_;  ///< their rows of M
  Eigen::VectorXd condensed_force_;
  std::vector<Eigen::LDLT<Eigen::MatrixXd>> axial_stiffness_;  ///< by beam
  /// One pair of shapes of a beam: what add_beam sums over.
  struct ShapePair {
    double product, cross, stiffness;
  };
  std::vector<std::vector<ShapePair>> shape_pairs_;  ///< by beam, k by l
  std::vector<Rotation> beam_turn_;                  ///< of its frame against its link
  std::vector<int> filled_;       ///< places of the mass matrix that the tree fills, lower triangle
  std::vector<double> inverse_;   ///< of the diagonal of factor_
  std::vector<Wrench> load_;      ///< on a link and all that it carries, without virial
  std::vector<Inertia> carried_;  ///< inertia of a link and all that it carries
  bool static_laws_ = false;
  bool strings_apart_ = false;
  std::vector<double> largest_;
  std::vector<TurningPoints> turns_;
  std::vector<double> law_;
  std::vector<double> law_rate_;
  std::vector<LawStates> law_states_;      ///< by contact
  std::vector<char> loaded_;               ///< by contact: law_states_ is of a closed contact
  std::vector<char> idle_;                 ///< by contact: nothing is evaluated while it is open
  std::vector<CycleStart> cycles_;         ///< by contact: of laws with memory, kept while it lasts
  std::vector<int> turning_;               ///< coordinates of the joints with friction
  std::vector<FrictionValue> resistance_;  ///< of these joints
  Eigen::VectorXd joint_friction_;         ///< of all coordinates, with dashpots
  std::vector<double> q_;
  std::vector<double> v_;
  Eigen::VectorXd force_;
  Eigen::VectorXd acceleration_;
  Eigen::MatrixXd mass_;
  Eigen::MatrixXd factor_;
  Eigen::MatrixXd stiffness_;
  Eigen::MatrixXd damping_;
  std::vector<ContactGradient> gradients_;
  int gradient_count_ = 0;
  std::vector<Vec2> column_a_, column_b_, dn_, dp_, du_;
  std::vector<Vec2> own_column_, first_, second_;  ///< by motion of one link
  std::vector<double> along_;                      ///< slip for a unit rate, by coordinate
};

}  // namespace feltmb
