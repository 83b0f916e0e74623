#include <pybind11/eigen.h>
#include <pybind11/numpy.h>
#include <pybind11/stl.h>

#include "bindings.hpp"
#include "feltmb/model/actuator.hpp"

namespace py = pybind11;

namespace feltmb::python {

void bind_actuator(py::module_& m) {
  py::class_<ArmSection>(m, "ArmSection")
      .def(py::init([](double length, double density, double area, double young_modulus,
                       double second_moment) {
             return ArmSection{length, density, area, young_modulus, second_moment};
           }),
           py::kw_only(), py::arg("length"), py::arg("density"), py::arg("area"),
           py::arg("young_modulus"), py::arg("second_moment"));
  py::enum_<TipPlacement>(m, "TipPlacement")
      .value("across", TipPlacement::kAcross)
      .value("along", TipPlacement::kAlong);
  py::class_<HubBeamDescription>(m, "HubBeamDescription")
      .def(py::init<>())
      .def_readwrite("hub_radius", &HubBeamDescription::hub_radius)
      .def_readwrite("hub_inertia", &HubBeamDescription::hub_inertia)
      .def_readwrite("sections", &HubBeamDescription::sections)
      .def_readwrite("tip_mass", &HubBeamDescription::tip_mass)
      .def_readwrite("eccentricity", &HubBeamDescription::eccentricity)
      .def_readwrite("tip", &HubBeamDescription::tip)
      .def_readwrite("elements", &HubBeamDescription::elements)
      .def_readwrite("printed_shapes", &HubBeamDescription::printed_shapes);
  py::class_<HubBeam>(m, "HubBeam")
      .def(py::init<HubBeamDescription>(), py::arg("description"))
      .def_property_readonly("length", &HubBeam::length)
      .def_property_readonly("reach", &HubBeam::reach)
      .def_property_readonly("stations", &HubBeam::stations)
      .def_property_readonly("mass", &HubBeam::mass)
      .def_property_readonly("stiffness", &HubBeam::stiffness)
      .def_property_readonly("tip", &HubBeam::tip)
      .def_property_readonly("weight", &HubBeam::weight)
      .def_property_readonly("rigid_inertia", &HubBeam::rigid_inertia)
      .def("frequencies", &HubBeam::frequencies, py::arg("count"), py::arg("clamped") = false,
           "The lowest frequencies [Hz] of the elastic arm, hub free or held.");

  py::enum_<DamperKind>(m, "DamperKind")
      .value("none", DamperKind::kNone)
      .value("dashpot", DamperKind::kDashpot)
      .value("one_sided", DamperKind::kOneSided);
  py::class_<ActuatorDescription>(m, "ActuatorDescription")
      .def(py::init<>())
      .def_readwrite("arm", &ActuatorDescription::arm)
      .def_readwrite("gravity", &ActuatorDescription::gravity)
      .def_readwrite("linear_gravity", &ActuatorDescription::linear_gravity)
      .def_readwrite("gap", &ActuatorDescription::gap)
      .def_property(
          "stop",
          [](const ActuatorDescription& d) {
            return d.stop ? std::optional<ContactLaw>(*d.stop) : std::nullopt;
          },
          [](ActuatorDescription& d, const std::optional<ContactLaw>& law) {
            d.stop.reset();
            if (law) d.stop = law->parameters();
          })
      .def_readwrite("damper", &ActuatorDescription::damper)
      .def_readwrite("damping", &ActuatorDescription::damping)
      .def_readwrite("action_mass", &ActuatorDescription::action_mass)
      .def_readwrite("action_force", &ActuatorDescription::action_force);
  py::class_<Actuator, std::shared_ptr<Actuator>>(m, "Actuator")
      .def(py::init<ActuatorDescription>(), py::arg("description"))
      .def_property_readonly("beam", &Actuator::beam, py::return_value_policy::reference_internal)
      .def(
          "mode_frequencies_squared",
          [](const Actuator& a, bool with_action) { return a.modes(with_action).stiffness; },
          py::arg("with_action") = false)
      .def(
          "simulate",
          [](const Actuator& a, const Profile& torque, double duration, double output_rate,
             double tolerance) {
            ActuatorRun run;
            {
              const WithoutInterpreter release;
              run = simulate(a, torque, {duration, output_rate, tolerance});
            }
            py::dict out;
            out["time"] = run.time;
            out["names"] = run.names;
            out["units"] = run.units;
            out["long_names"] = run.long_names;
            out["data"] = run.data;
            py::list events;
            for (const auto& e : run.events) {
              events.append(py::make_tuple(e.time, e.direction, e.rate));
            }
            out["events"] = events;
            out["peak_force"] = run.peak_force;
            out["peak_time"] = run.peak_time;
            py::dict counts;
            counts["steps"] = run.counts.steps;
            counts["rejected"] = run.counts.rejected;
            counts["free"] = run.counts.free;
            counts["forces"] = run.counts.forces;
            out["counts"] = counts;
            out["wall"] = run.wall;
            return out;
          },
          py::arg("torque"), py::arg("duration") = 0.2, py::arg("output_rate") = 10000.0,
          py::arg("tolerance") = 1e-5);
}

}  // namespace feltmb::python
