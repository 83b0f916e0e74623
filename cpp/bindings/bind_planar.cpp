#include <pybind11/eigen.h>
#include <pybind11/numpy.h>
#include <pybind11/stl.h>

#include "bindings.hpp"
#include "feltmb/core/error.hpp"
#include "feltmb/planar/dynamics.hpp"
#include "feltmb/planar/mechanism.hpp"

namespace py = pybind11;

namespace feltmb::python {
namespace {

std::pair<double, double> pair(Vec2 v) { return {v.x, v.y}; }

template <class Class, class Owner>
void vec2(Class& c, const char* name, Vec2 Owner::* member) {
  c.def_property(
      name, [member](const Owner& o) { return pair(o.*member); },
      [member](Owner& o, std::pair<double, double> v) { o.*member = {v.first, v.second}; });
}

void bind_description(py::module_& m) {
  py::enum_<JointKind>(m, "JointKind")
      .value("revolute", JointKind::kRevolute)
      .value("prismatic", JointKind::kPrismatic)
      .value("weld", JointKind::kWeld);
  py::enum_<SurfaceKind>(m, "SurfaceKind")
      .value("line", SurfaceKind::kLine)
      .value("circle", SurfaceKind::kCircle)
      .value("concave", SurfaceKind::kConcave)
      .value("hybrid", SurfaceKind::kHybrid);

  py::enum_<ShapeSet>(m, "ShapeSet")
      .value("polynomial", ShapeSet::kPolynomial)
      .value("clamped_free", ShapeSet::kClampedFree)
      .value("craig_bampton", ShapeSet::kCraigBampton);
  py::class_<BeamDescription>(m, "BeamDescription")
      .def(py::init<>())
      .def_readwrite("length", &BeamDescription::length)
      .def_readwrite("linear_density", &BeamDescription::linear_density)
      .def_readwrite("axial_stiffness", &BeamDescription::axial_stiffness)
      .def_readwrite("bending_stiffness", &BeamDescription::bending_stiffness)
      .def_readwrite("shapes", &BeamDescription::shapes)
      .def_readwrite("axial_shapes", &BeamDescription::axial_shapes)
      .def_readwrite("lateral_shapes", &BeamDescription::lateral_shapes)
      .def_readwrite("damping_time", &BeamDescription::damping_time)
      .def_readwrite("condense_axial", &BeamDescription::condense_axial);

  py::class_<BodyDescription> body(m, "BodyDescription");
  body.def(py::init<>())
      .def_readwrite("name", &BodyDescription::name)
      .def_readwrite("parent", &BodyDescription::parent)
      .def_readwrite("joint", &BodyDescription::joint)
      .def_readwrite("angle", &BodyDescription::angle)
      .def_readwrite("coordinate", &BodyDescription::coordinate)
      .def_readwrite("friction", &BodyDescription::friction)
      .def_readwrite("mass", &BodyDescription::mass)
      .def_readwrite("inertia", &BodyDescription::inertia)
      .def_readwrite("beam", &BodyDescription::beam);
  vec2(body, "position", &BodyDescription::position);
  vec2(body, "axis", &BodyDescription::axis);
  vec2(body, "center_of_mass", &BodyDescription::center_of_mass);

  py::class_<SurfaceDescription> surface(m, "SurfaceDescription");
  surface.def(py::init<>())
      .def_readwrite("name", &SurfaceDescription::name)
      .def_readwrite("body", &SurfaceDescription::body)
      .def_readwrite("kind", &SurfaceDescription::kind)
      .def_readwrite("radius", &SurfaceDescription::radius)
      .def_readwrite("arc", &SurfaceDescription::arc);
  vec2(surface, "point", &SurfaceDescription::point);
  vec2(surface, "normal", &SurfaceDescription::normal);

  py::class_<ContactDescription>(m, "ContactDescription")
      .def(py::init<>())
      .def_readwrite("number", &ContactDescription::number)
      .def_readwrite("label", &ContactDescription::label)
      .def_readwrite("surface_a", &ContactDescription::surface_a)
      .def_readwrite("surface_b", &ContactDescription::surface_b)
      .def_property(
          "law", [](const ContactDescription& c) { return ContactLaw(c.law); },
          [](ContactDescription& c, const ContactLaw& law) { c.law = law.parameters(); })
      .def_readwrite("friction", &ContactDescription::friction)
      .def_readwrite("enabled", &ContactDescription::enabled);

  py::class_<TorsionSpringDescription>(m, "TorsionSpringDescription")
      .def(py::init<>())
      .def_readwrite("name", &TorsionSpringDescription::name)
      .def_readwrite("coordinate", &TorsionSpringDescription::coordinate)
      .def_readwrite("stiffness", &TorsionSpringDescription::stiffness)
      .def_readwrite("rest_angle", &TorsionSpringDescription::rest_angle)
      .def_readwrite("damping", &TorsionSpringDescription::damping)
      .def_readwrite("clearance", &TorsionSpringDescription::clearance)
      .def_readwrite("seating", &TorsionSpringDescription::seating);

  py::class_<DashpotDescription>(m, "DashpotDescription")
      .def(py::init<>())
      .def_readwrite("name", &DashpotDescription::name)
      .def_readwrite("coordinate", &DashpotDescription::coordinate)
      .def_readwrite("coefficient", &DashpotDescription::coefficient)
      .def_readwrite("side", &DashpotDescription::side);

  py::class_<StrapDescription> strap(m, "StrapDescription");
  strap.def(py::init<>())
      .def_readwrite("name", &StrapDescription::name)
      .def_readwrite("body_a", &StrapDescription::body_a)
      .def_readwrite("body_b", &StrapDescription::body_b)
      .def_readwrite("free_length", &StrapDescription::free_length)
      .def_readwrite("coefficients", &StrapDescription::coefficients);
  vec2(strap, "point_a", &StrapDescription::point_a);
  vec2(strap, "point_b", &StrapDescription::point_b);

  py::class_<StringDescription> string(m, "StringDescription");
  string.def(py::init<>())
      .def_readwrite("name", &StringDescription::name)
      .def_readwrite("surface", &StringDescription::surface)
      .def_readwrite("other_surfaces", &StringDescription::other_surfaces)
      .def_readwrite("rigid", &StringDescription::rigid)
      .def_readwrite("parameters", &StringDescription::parameters)
      .def_readwrite("anchor", &StringDescription::anchor)
      .def_readwrite("moving_strike_point", &StringDescription::moving_strike_point)
      .def_readwrite("strike_position", &StringDescription::strike_position);
  vec2(string, "direction", &StringDescription::direction);

  py::class_<TrackingPointDescription> point(m, "TrackingPointDescription");
  point.def(py::init<>())
      .def_readwrite("name", &TrackingPointDescription::name)
      .def_readwrite("body", &TrackingPointDescription::body);
  vec2(point, "point", &TrackingPointDescription::point);

  py::class_<FingerDescription> finger(m, "FingerDescription");
  finger.def(py::init<>())
      .def_readwrite("body", &FingerDescription::body)
      .def_property(
          "pad", [](const FingerDescription& f) { return ContactLaw(f.pad); },
          [](FingerDescription& f, const ContactLaw& law) { f.pad = law.parameters(); });
  vec2(finger, "point", &FingerDescription::point);
  vec2(finger, "direction", &FingerDescription::direction);

  py::class_<MotorDescription>(m, "MotorDescription")
      .def(py::init<>())
      .def_readwrite("coordinate", &MotorDescription::coordinate)
      .def_readwrite("contact", &MotorDescription::contact);

  py::class_<MechanismDescription> mechanism(m, "MechanismDescription");
  mechanism.def(py::init<>())
      .def_readwrite("name", &MechanismDescription::name)
      .def_readwrite("bodies", &MechanismDescription::bodies)
      .def_readwrite("surfaces", &MechanismDescription::surfaces)
      .def_readwrite("contacts", &MechanismDescription::contacts)
      .def_readwrite("springs", &MechanismDescription::springs)
      .def_readwrite("dashpots", &MechanismDescription::dashpots)
      .def_readwrite("straps", &MechanismDescription::straps)
      .def_readwrite("strings", &MechanismDescription::strings)
      .def_readwrite("points", &MechanismDescription::points)
      .def_readwrite("finger", &MechanismDescription::finger)
      .def_readwrite("motor", &MechanismDescription::motor)
      .def_readwrite("start_pose", &MechanismDescription::start_pose);
  vec2(mechanism, "gravity", &MechanismDescription::gravity);
}

}  // namespace

void bind_planar(py::module_& m) {
  bind_description(m);

  py::class_<Mechanism, std::shared_ptr<Mechanism>>(m, "Mechanism")
      .def_readonly("name", &Mechanism::name)
      .def_readonly("coordinates", &Mechanism::coordinates)
      .def_readonly("coordinate_scale", &Mechanism::coordinate_scale)
      .def_readonly("total_modes", &Mechanism::total_modes)
      .def_readonly("total_law_states", &Mechanism::total_law_states)
      .def_property_readonly("law_state_names",
                             [](const Mechanism& mech) {
                               std::vector<std::string> names;
                               for (const auto& c : mech.contacts) {
                                 for (std::size_t i = 0; i < c.law.n_states(); ++i) {
                                   names.push_back(c.name + "." + c.law.state_name(i));
                                 }
                               }
                               return names;
                             })
      .def_property_readonly("coordinate_units",
                             [](const Mechanism& self) {
                               std::vector<std::string> units;
                               for (const bool angle : self.coordinate_is_angle) {
                                 units.push_back(angle ? "rad" : "m");
                               }
                               return units;
                             })
      .def_property_readonly("contact_numbers",
                             [](const Mechanism& self) {
                               std::vector<int> numbers;
                               for (const auto& c : self.contacts) numbers.push_back(c.number);
                               return numbers;
                             })
      .def_property_readonly("contact_names",
                             [](const Mechanism& self) {
                               std::vector<std::string> names;
                               for (const auto& c : self.contacts) names.push_back(c.name);
                               return names;
                             })
      .def(
          "beam_centerline",
          [](const Mechanism& self, const std::string& name, const Eigen::VectorXd& q, int count) {
            for (const auto& beam : self.beams) {
              if (beam.name != name) continue;
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
            throw InvalidParameter("beam_centerline: no flexible beam \"" + name + "\"");
          },
          py::arg("name"), py::arg("q"), py::arg("count") = 20,
          "Centerline (count, 2) [m] of a flexible beam in its own clamped frame.")
      .def_property_readonly("beam_names",
                             [](const Mechanism& self) {
                               std::vector<std::string> names;
                               for (const auto& b : self.beams) names.push_back(b.name);
                               return names;
                             })
      .def_property_readonly("point_names", [](const Mechanism& self) {
        std::vector<std::string> names;
        for (const auto& p : self.points) names.push_back(p.name);
        return names;
      });

  m.def(
      "assemble",
      [](const MechanismDescription& d) { return std::const_pointer_cast<Mechanism>(assemble(d)); },
      py::arg("description"), "Checked, immutable mechanism; one error lists all faults.");

  m.def(
      "evaluate",
      [](const std::shared_ptr<Mechanism>& mechanism, const Eigen::VectorXd& q,
         const Eigen::VectorXd& qd, double finger_force) {
        const auto n = static_cast<Eigen::Index>(mechanism->size());
        if (q.size() != n || qd.size() != n) {
          throw InvalidParameter(format(
              "evaluate: got q of length %ld and qd of length %ld, "
              "expected %ld (the coordinates of the mechanism)",
              static_cast<long>(q.size()), static_cast<long>(qd.size()), static_cast<long>(n)));
        }
        if (!q.allFinite() || !qd.allFinite()) {
          throw InvalidParameter("evaluate: q or qd holds a value that is not a finite number");
        }
        Dynamics dynamics(mechanism);
        const std::vector<double> zero(static_cast<std::size_t>(mechanism->total_modes), 0.0);
        Drive drive;
        drive.force = finger_force;
        const auto count = static_cast<std::size_t>(n);
        const std::vector<double> law(static_cast<std::size_t>(mechanism->total_law_states), 0.0);
        dynamics.evaluate({{q.data(), count}, {qd.data(), count}, law, zero, zero}, drive,
                          Detail::kAllContacts);
        py::dict out;
        out["mass_matrix"] = dynamics.mass_matrix();
        out["force"] = dynamics.force();
        out["acceleration"] = dynamics.acceleration();
        py::list rows;
        for (std::size_t i = 0; i < mechanism->contacts.size(); ++i) {
          const Contact& contact = mechanism->contacts[i];
          if (contact.finger) continue;
          const ContactState& s = dynamics.contacts()[i];
          rows.append(py::make_tuple(contact.number, s.compression, s.rate, s.law.force, s.slip,
                                     -s.friction.value * s.law.force, s.point.x, s.point.y,
                                     s.normal.x, s.normal.y));
        }
        out["contacts"] = rows;
        return out;
      },
      py::arg("mechanism"), py::arg("q"), py::arg("qd"), py::arg("finger_force") = 0.0);

  m.def(
      "body_poses",
      [](const std::shared_ptr<Mechanism>& mechanism, const Eigen::VectorXd& q) {
        Dynamics dynamics(mechanism);
        const std::vector<double> zero(static_cast<std::size_t>(mechanism->total_modes), 0.0);
        const std::vector<double> rest(static_cast<std::size_t>(mechanism->size()), 0.0);
        if (q.size() != mechanism->size()) {
          throw InvalidParameter(format("body_poses: got q of length %ld, expected %d",
                                        static_cast<long>(q.size()), mechanism->size()));
        }
        const std::vector<double> law(static_cast<std::size_t>(mechanism->total_law_states), 0.0);
        dynamics.locate({{q.data(), static_cast<std::size_t>(q.size())}, rest, law, zero, zero},
                        {});
        py::dict out;
        for (const auto& [name, placement] : mechanism->bodies) {
          const LinkState& s = dynamics.links()[static_cast<std::size_t>(placement.link)];
          const Vec2 origin = s.origin + s.rotation * placement.offset;
          out[py::str(name)] = py::make_tuple(
              origin.x, origin.y, std::atan2(s.rotation.s, s.rotation.c) + placement.angle);
        }
        return out;
      },
      py::arg("mechanism"), py::arg("q"),
      "Origin x, y [m] and angle [rad] of every body in the ground frame; of a flexible beam at "
      "its "
      "clamped end.");

  m.def(
      "point_position",
      [](const std::shared_ptr<Mechanism>& mechanism, int point, const Eigen::VectorXd& q) {
        if (q.size() != mechanism->size() || point < 0 ||
            point >= static_cast<int>(mechanism->points.size())) {
          throw InvalidParameter("point_position: no such point, or q of the wrong length");
        }
        Dynamics dynamics(mechanism);
        const std::vector<double> zero(static_cast<std::size_t>(mechanism->total_modes), 0.0);
        const std::vector<double> rest(static_cast<std::size_t>(mechanism->size()), 0.0);
        const std::vector<double> law(static_cast<std::size_t>(mechanism->total_law_states), 0.0);
        dynamics.locate({{q.data(), static_cast<std::size_t>(q.size())}, rest, law, zero, zero},
                        {});
        return pair(dynamics.position(mechanism->points[static_cast<std::size_t>(point)].point));
      },
      py::arg("mechanism"), py::arg("point"), py::arg("q"),
      "Position [m] of a tracking point in the ground frame.");

  m.def(
      "finger_place",
      [](const std::shared_ptr<Mechanism>& mechanism, const Eigen::VectorXd& q) {
        if (q.size() != mechanism->size() || mechanism->finger_contact < 0) {
          throw InvalidParameter("finger_place: no finger, or q of the wrong length");
        }
        Dynamics dynamics(mechanism);
        const std::vector<double> zero(static_cast<std::size_t>(mechanism->total_modes), 0.0);
        const std::vector<double> rest(static_cast<std::size_t>(mechanism->size()), 0.0);
        const std::vector<double> law(static_cast<std::size_t>(mechanism->total_law_states), 0.0);
        dynamics.locate({{q.data(), static_cast<std::size_t>(q.size())}, rest, law, zero, zero},
                        {});
        return dot(mechanism->finger_direction, dynamics.position(mechanism->finger_point));
      },
      py::arg("mechanism"), py::arg("q"), "Place of the finger's point along its direction [m].");

  m.def(
      "jacobian_blocks",
      [](const std::shared_ptr<Mechanism>& mechanism, const Eigen::VectorXd& q,
         const Eigen::VectorXd& qd, double finger_force) {
        Dynamics dynamics(mechanism);
        const std::vector<double> zero(static_cast<std::size_t>(mechanism->total_modes), 0.0);
        Drive drive;
        drive.force = finger_force;
        const auto count = static_cast<std::size_t>(mechanism->size());
        const std::vector<double> law(static_cast<std::size_t>(mechanism->total_law_states), 0.0);
        dynamics.evaluate({{q.data(), count}, {qd.data(), count}, law, zero, zero}, drive);
        dynamics.differentiate();
        Eigen::MatrixXd stiffness = dynamics.stiffness();
        Eigen::MatrixXd damping = dynamics.damping();
        for (const auto& g : dynamics.gradients()) {
          const LawValue& law = dynamics.contacts()[static_cast<std::size_t>(g.contact)].law;
          stiffness +=
              (law.d_compression * g.by_force + g.by_compression) * g.compression.transpose() +
              law.d_rate * g.by_force * g.rate.transpose();
          damping += law.d_rate * g.by_force * g.compression.transpose();
        }
        return py::make_tuple(stiffness, damping);
      },
      py::arg("mechanism"), py::arg("q"), py::arg("qd"), py::arg("finger_force") = 0.0,
      "d(Q - M a)/dq and d(Q - M a)/dqd at fixed acceleration a.");
}

}  // namespace feltmb::python
