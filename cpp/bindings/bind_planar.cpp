#include <pybind11/eigen.h>
#include <pybind11/numpy.h>
#include <pybind11/stl.h>

#include "bindings.hpp"
#include "feltmb/core/error.hpp"
#include "feltmb/planar/archive.hpp"
#include "feltmb/planar/dynamics.hpp"
#include "feltmb/planar/mechanism.hpp"
#include "feltmb/planar/poses.hpp"
#include "fields.hpp"

namespace py = pybind11;

namespace feltmb::python {
namespace {

void bind_description(py::module_& m) {
  py::enum_<JointKind>(m, "JointKind")
      .value("revolute", JointKind::kRevolute)
      .value("prismatic", JointKind::kPrismatic)
      .value("weld", JointKind::kWeld);
  py::enum_<SurfaceKind>(m, "SurfaceKind")
      .value("line", SurfaceKind::kLine)
      .value("circle", SurfaceKind::kCircle)
      .value("concave", SurfaceKind::kConcave)
      .value("hybrid", SurfaceKind::kHybrid)
      .value("segment", SurfaceKind::kSegment)
      .value("concave_arc", SurfaceKind::kConcaveArc);

  py::enum_<ShapeSet>(m, "ShapeSet")
      .value("polynomial", ShapeSet::kPolynomial)
      .value("clamped_free", ShapeSet::kClampedFree)
      .value("craig_bampton", ShapeSet::kCraigBampton);
  bind_fields<BeamDescription>(m, "BeamDescription");
  bind_fields<BodyDescription>(m, "BodyDescription");
  bind_fields<SurfaceDescription>(m, "SurfaceDescription");
  bind_fields<ContactDescription>(m, "ContactDescription");
  bind_fields<TorsionSpringDescription>(m, "TorsionSpringDescription");
  bind_fields<DashpotDescription>(m, "DashpotDescription");
  bind_fields<StrapDescription>(m, "StrapDescription");
  bind_fields<StringDescription>(m, "StringDescription");
  bind_fields<TrackingPointDescription>(m, "TrackingPointDescription");
  bind_fields<FingerDescription>(m, "FingerDescription");
  bind_fields<MotorDescription>(m, "MotorDescription");
  bind_fields<MechanismDescription>(m, "MechanismDescription");
}

py::list rows_of(const std::vector<DescriptionNumber>& numbers) {
  py::list out;
  for (const DescriptionNumber& n : numbers) {
    py::dict row;
    row["path"] = n.path;
    row["unit"] = n.unit;
    row["meaning"] = n.meaning;
    row["value"] = *n.value;
    add_range(row, n.range);
    out.append(row);
  }
  return out;
}

py::dict move_through(const std::shared_ptr<Mechanism>& mechanism, const Eigen::MatrixXd& q,
                      int count) {
  const Poses found = poses_along(mechanism, q, count);
  py::dict beams;
  for (const auto& [name, lines] : found.beams) beams[py::str(name)] = lines;
  py::dict out;
  out["beams"] = beams;
  out["names"] = found.names;
  out["bodies"] = found.bodies;
  out["numbers"] = found.numbers;
  out["contacts"] = found.contacts;
  return out;
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
            for (const auto& beam : self.beams)
              if (beam.name == name) return centerline(beam, q, count);
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

  m.def("write_description", &write_description, py::arg("description"),
        "Text of a description, to the last bit.");
  m.def("read_description", &read_description, py::arg("text"));
  m.def(
      "description_numbers", [](MechanismDescription own) { return rows_of(numbers_of(own)); },
      py::arg("description"), "Path, unit, meaning, value and limits of all real numbers.");
  m.def(
      "write_law", [](const ContactLaw& law) { return write_law(law.parameters()); },
      py::arg("law"), "Text of a contact law, to the last bit.");
  m.def(
      "law_numbers",
      [](const ContactLaw& law) {
        LawParameters own = law.parameters();
        return rows_of(numbers_of(own));
      },
      py::arg("law"), "Path, unit, meaning, value and limits of all real numbers.");
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
        const Dynamics dynamics = located(mechanism, q);
        py::dict out;
        for (const auto& [name, placement] : mechanism->bodies) {
          const auto [x, y, angle] = pose_of(dynamics, placement);
          out[py::str(name)] = py::make_tuple(x, y, angle);
        }
        return out;
      },
      py::arg("mechanism"), py::arg("q"),
      "Origin x, y [m] and angle [rad] of every body in the ground frame; of a flexible beam at "
      "its "
      "clamped end.");

  m.def("move_through", &move_through, py::arg("mechanism"), py::arg("q"), py::arg("count") = 25,
        "Poses, one a row of q: ``names`` and ``bodies`` (x, y [m], angle [rad] of each, side by "
        "side), ``numbers`` and ``contacts`` (x, y [m] and unit normal of each; no finger), "
        "``beams``: by name the centerline's ``count`` points [m] in the clamped frame.");

  m.def(
      "point_position",
      [](const std::shared_ptr<Mechanism>& mechanism, int point, const Eigen::VectorXd& q) {
        if (point < 0 || point >= static_cast<int>(mechanism->points.size())) {
          throw InvalidParameter("point_position: no such point");
        }
        const Dynamics dynamics = located(mechanism, q);
        return to_python(
            dynamics.position(mechanism->points[static_cast<std::size_t>(point)].point));
      },
      py::arg("mechanism"), py::arg("point"), py::arg("q"),
      "Position [m] of a tracking point in the ground frame.");

  m.def(
      "finger_place",
      [](const std::shared_ptr<Mechanism>& mechanism, const Eigen::VectorXd& q) {
        return finger_place(mechanism, q);
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
