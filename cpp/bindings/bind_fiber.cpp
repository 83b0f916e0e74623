// Submodule `fiber`: arguments -> core call -> return, no physics here.
#include <pybind11/eigen.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <memory>
#include <string>

#include "bindings.hpp"
#include "feltmb/core/error.hpp"
#include "feltmb/fiber/bead_spring.hpp"
#include "feltmb/fiber/carnaby_pan.hpp"
#include "feltmb/fiber/compression.hpp"
#include "feltmb/fiber/contact_count.hpp"
#include "feltmb/fiber/energy_method.hpp"
#include "feltmb/fiber/granular_rate.hpp"
#include "feltmb/fiber/history.hpp"
#include "feltmb/fiber/orientation.hpp"

namespace py = pybind11;

namespace feltmb::python {

namespace {

using Array = py::array_t<double, py::array::c_style | py::array::forcecast>;

std::span<const double> view(const Array& a) {
  return {a.data(), static_cast<std::size_t>(a.size())};
}

Array same_shape(const Array& a) {
  return Array(std::vector<py::ssize_t>(a.shape(), a.shape() + a.ndim()));
}

Array tensor(const Tensor4& t) {
  Array result({3, 3, 3, 3});
  std::copy(t.begin(), t.end(), result.mutable_data());
  return result;
}

Tensor4 tensor(const Array& a) {
  if (a.ndim() != 4 || a.size() != 81) {
    throw InvalidParameter(format("rank four tensor: %zd numbers, expected shape (3, 3, 3, 3)",
                                  static_cast<std::ptrdiff_t>(a.size())));
  }
  Tensor4 result;
  std::copy(a.data(), a.data() + 81, result.begin());
  return result;
}

/// A law together with what made it, so that it can be shown and pickled.
struct Law {
  std::string name;
  std::map<std::string, double> parameters;
  std::shared_ptr<const CompressionLaw> law;
  Law(std::string n, std::map<std::string, double> p)
      : name(std::move(n)), parameters(std::move(p)), law(make_law(name, parameters)) {}

  [[nodiscard]] Array evaluate(LawQuantity quantity, const Array& v, std::size_t threads) const {
    Array out = same_shape(v);
    const std::span<double> target(out.mutable_data(), static_cast<std::size_t>(out.size()));
    {
      const feltmb::python::WithoutInterpreter release;
      evaluate_law(*law, quantity, view(v), target, threads);
    }
    return out;
  }
};

template <class F>
Array map_cosine(double ratio, const Array& cosine, F&& f) {
  Array out = same_shape(cosine);
  for (py::ssize_t i = 0; i < cosine.size(); ++i) {
    out.mutable_data()[i] = f(ratio, cosine.data()[i]);
  }
  return out;
}

CompressionScheme scheme_of(const std::string& name) {
  if (name == "isotropic") return CompressionScheme::isotropic;
  if (name == "confined") return CompressionScheme::confined;
  if (name == "simple") return CompressionScheme::simple;
  throw InvalidParameter("energy method: scheme = \"" + name +
                         "\", must be one of isotropic, confined, simple");
}

ContactCounting counting_of(const std::string& name) {
  if (name == "source") return ContactCounting::source;
  if (name == "once") return ContactCounting::once;
  if (name == "ends") return ContactCounting::ends;
  throw InvalidParameter("contacts: counting = \"" + name +
                         "\", must be one of source, once, ends");
}

void bind_orientation(py::module_& m) {
  py::class_<UniaxialStructure>(m, "UniaxialStructure",
                                "Structural numbers after compression by R; dimensionless.")
      .def_readonly("ratio", &UniaxialStructure::ratio, "R = v_f / v_random [-]")
      .def_readonly("f", &UniaxialStructure::f, "mean |e x e'| [-]")
      .def_readonly("n3", &UniaxialStructure::n3, "<n3^4>_c [-]")
      .def_readonly("e3", &UniaxialStructure::e3, "<e3^4>_c [-]")
      .def_readonly("K3", &UniaxialStructure::K3, "mean |cos theta| [-]")
      .def_readonly("M3", &UniaxialStructure::M3, "mean sin^2 theta [-]")
      .def_readonly("cos4", &UniaxialStructure::cos4, "mean cos^4 theta [-]")
      .def_readonly("sine", &UniaxialStructure::sine, "mean sin theta [-]")
      .def(
          "density",
          [](const UniaxialStructure& s, const Array& cosine) {
            return map_cosine(s.ratio, cosine, uniaxial_density);
          },
          py::arg("cos_theta"), "Omega(theta) on the half sphere [1/sr].")
      .def(
          "mean_sine",
          [](const UniaxialStructure& s, const Array& cosine) {
            return map_cosine(s.ratio, cosine, uniaxial_mean_sine);
          },
          py::arg("cos_theta"), "J(theta), eq. 3.5 [-].")
      .def(
          "mean_inverse_sine",
          [](const UniaxialStructure& s, const Array& cosine) {
            return map_cosine(s.ratio, cosine, uniaxial_mean_inverse_sine);
          },
          py::arg("cos_theta"), "Theta(theta), eq. 3.9 [-].")
      .def(
          "obstruction", [](const UniaxialStructure& s) { return uniaxial_obstruction(s.ratio); },
          "Psi of Pan's model [-].")
      .def("__repr__", [](const UniaxialStructure& s) {
        return format("UniaxialStructure(ratio=%.6g, f=%.9g, n3=%.9g, e3=%.9g, K3=%.9g, M3=%.9g)",
                      s.ratio, s.f, s.n3, s.e3, s.K3, s.M3);
      });
  m.def("compute_uniaxial_structure", &compute_uniaxial_structure, py::arg("ratio"));
  m.def("uniaxial_structure", &uniaxial_structure, py::arg("ratio"));

  py::class_<FiberStructure>(m, "FiberStructure",
                             "Averages over a general orientation; dimensionless.")
      .def_readonly("f", &FiberStructure::f)
      .def_readonly("n3", &FiberStructure::n3)
      .def_readonly("e3", &FiberStructure::e3)
      .def_readonly("K3", &FiberStructure::K3)
      .def_readonly("M3", &FiberStructure::M3)
      .def_readonly("obstruction", &FiberStructure::obstruction)
      .def_property_readonly("ee", [](const FiberStructure& s) { return Eigen::Matrix3d(s.ee); })
      .def_property_readonly("eeee", [](const FiberStructure& s) { return tensor(s.eeee); })
      .def_property_readonly("nnnn_contact",
                             [](const FiberStructure& s) { return tensor(s.nnnn_contact); })
      .def_property_readonly("eeee_contact",
                             [](const FiberStructure& s) { return tensor(s.eeee_contact); })
      .def_property_readonly("tttt_contact",
                             [](const FiberStructure& s) { return tensor(s.tttt_contact); })
      .def("__repr__", [](const FiberStructure& s) {
        return format("FiberStructure(f=%.9g, n3=%.9g, e3=%.9g, K3=%.9g, M3=%.9g)", s.f, s.n3, s.e3,
                      s.K3, s.M3);
      });

  py::class_<OrientationQuadrature>(m, "OrientationQuadrature")
      .def(py::init<std::size_t, std::size_t, std::size_t, bool>(), py::arg("n_polar"),
           py::arg("n_azimuth"), py::arg("n_circle"), py::arg("obstruction") = false)
      .def("size", &OrientationQuadrature::size)
      .def("directions", &OrientationQuadrature::directions)
      .def(
          "norm", [](const OrientationQuadrature& q, const Array& d) { return q.norm(view(d)); },
          py::arg("density"))
      .def(
          "compute",
          [](const OrientationQuadrature& q, const Array& d) {
            const feltmb::python::WithoutInterpreter release;
            return q.compute(view(d));
          },
          py::arg("density"));

  m.def("affine_density", &affine_density, py::arg("deformation"), py::arg("directions"));
  m.def("make_random_directions", &make_random_directions, py::arg("n"), py::arg("seed"),
        py::arg("spread"), py::arg("threads") = 0,
        py::call_guard<feltmb::python::WithoutInterpreter>());
  m.def("deform_directions", &deform_directions, py::arg("directions"), py::arg("deformation"));
  m.def(
      "estimate_structure",
      [](const Eigen::Ref<const Directions>& directions, std::size_t threads) {
        SampledStructure s{};
        {
          const feltmb::python::WithoutInterpreter release;
          s = estimate_structure(directions, threads);
        }
        py::dict result;
        const auto put = [&](const char* key, const Estimate& e) {
          result[key] = py::make_tuple(e.value, e.error);
        };
        put("f", s.f);
        put("n3", s.n3);
        put("e3", s.e3);
        put("K3", s.K3);
        put("M3", s.M3);
        return result;
      },
      py::arg("directions"), py::arg("threads") = 0);
  m.def("estimate_tensors", &estimate_tensors, py::arg("directions"), py::arg("threads") = 0,
        py::call_guard<feltmb::python::WithoutInterpreter>());
  m.def(
      "narter_stiffness",
      [](const Array& eeee, double stiffness) {
        return Eigen::Matrix<double, 6, 6>(narter_stiffness(tensor(eeee), stiffness));
      },
      py::arg("eeee"), py::arg("stiffness"));
  m.def("narter_compliance", &narter_compliance, py::arg("stiffness"));
  m.def(
      "engineering_moduli",
      [](const Eigen::Matrix<double, 6, 6>& c) {
        const EngineeringModuli e = engineering_moduli(c);
        return py::make_tuple(e.young, e.shear, e.poisson);
      },
      py::arg("compliance"));
}

void bind_contacts(py::module_& m) {
  m.def("contact_model_names", [] { return contact_model_names(); });
  const auto input = [](double v_f, double d_f, double f, double sine, double obstruction,
                        double gamma, double q, double diameter_cv, bool as_printed) {
    ContactInput in{};
    in.v_f = v_f;
    in.d_f = d_f;
    in.f = f;
    in.sine = sine;
    in.obstruction = obstruction;
    in.gamma = gamma;
    in.Q = q;
    in.diameter_cv = diameter_cv;
    in.as_printed = as_printed;
    return in;
  };
  m.def(
      "mean_free_length",
      [input](const std::string& model, double v_f, double d_f, double f, double sine,
              double obstruction, double gamma, double q, double diameter_cv, bool as_printed) {
        return mean_free_length(contact_model(model), input(v_f, d_f, f, sine, obstruction, gamma,
                                                            q, diameter_cv, as_printed));
      },
      py::arg("model"), py::arg("v_f"), py::arg("d_f"), py::kw_only(), py::arg("f"),
      py::arg("sine"), py::arg("obstruction"), py::arg("gamma"), py::arg("Q"),
      py::arg("diameter_cv"), py::arg("as_printed"));
  m.def(
      "contacts_per_volume",
      [input](const std::string& model, double v_f, double d_f, double f, double sine,
              double obstruction, double gamma, double q, double diameter_cv, bool as_printed,
              const std::string& counting) {
        return contacts_per_volume(
            contact_model(model),
            input(v_f, d_f, f, sine, obstruction, gamma, q, diameter_cv, as_printed),
            counting_of(counting));
      },
      py::arg("model"), py::arg("v_f"), py::arg("d_f"), py::kw_only(), py::arg("f"),
      py::arg("sine"), py::arg("obstruction"), py::arg("gamma"), py::arg("Q"),
      py::arg("diameter_cv"), py::arg("as_printed"), py::arg("counting"));
  const auto count = [](double v_f, double d_f, double fiber_length, double ratio, double length_cv,
                        double gamma) {
    CountInput in{};
    in.v_f = v_f;
    in.d_f = d_f;
    in.fiber_length = fiber_length;
    in.ratio = ratio;
    in.length_cv = length_cv;
    in.gamma = gamma;
    return in;
  };
  m.def(
      "contact_count_distribution",
      [count](const std::string& model, std::size_t k_max, double v_f, double d_f,
              double fiber_length, double ratio, double length_cv, double gamma) {
        const CountInput in = count(v_f, d_f, fiber_length, ratio, length_cv, gamma);
        std::vector<double> p;
        {
          const feltmb::python::WithoutInterpreter release;
          p = contact_count_distribution(contact_model(model), in, k_max);
        }
        return Array(static_cast<py::ssize_t>(p.size()), p.data());
      },
      py::arg("model"), py::arg("k_max"), py::kw_only(), py::arg("v_f"), py::arg("d_f"),
      py::arg("fiber_length"), py::arg("ratio"), py::arg("length_cv"), py::arg("gamma"));
  m.def(
      "free_length_survival",
      [count](const std::string& model, const Array& x, double v_f, double d_f, double fiber_length,
              double ratio, double gamma) {
        const CountInput in = count(v_f, d_f, fiber_length, ratio, 0.0, gamma);
        Array out = same_shape(x);
        for (py::ssize_t i = 0; i < x.size(); ++i) {
          out.mutable_data()[i] = free_length_survival(contact_model(model), in, x.data()[i]);
        }
        return out;
      },
      py::arg("model"), py::arg("x"), py::kw_only(), py::arg("v_f"), py::arg("d_f"),
      py::arg("fiber_length"), py::arg("ratio"), py::arg("gamma"));
}

void bind_laws(py::module_& m) {
  py::class_<LawParameter>(m, "LawParameter", "Description of one parameter of a law.")
      .def_readonly("name", &LawParameter::name)
      .def_readonly("unit", &LawParameter::unit)
      .def_readonly("default", &LawParameter::default_value)
      .def_readonly("low", &LawParameter::low)
      .def_readonly("high", &LawParameter::high)
      .def_readonly("low_open", &LawParameter::low_open)
      .def_readonly("fit_low", &LawParameter::fit_low)
      .def_readonly("fit_high", &LawParameter::fit_high)
      .def_readonly("log_scale", &LawParameter::log_scale)
      .def_readonly("meaning", &LawParameter::meaning);
  py::class_<LawDescription>(m, "LawDescription", "Name, source and parameters of a law.")
      .def_readonly("name", &LawDescription::name)
      .def_readonly("title", &LawDescription::title)
      .def_readonly("source", &LawDescription::source)
      .def_readonly("validity", &LawDescription::validity)
      .def_readonly("parameters", &LawDescription::parameters);
  m.def("law_descriptions", [] { return law_descriptions(); });
  m.def("history_descriptions", [] { return history_descriptions(); });

  py::class_<Law>(m, "CompressionLaw", "A compression law with its parameters; immutable.")
      .def(py::init<std::string, std::map<std::string, double>>(), py::arg("name"),
           py::arg("parameters"))
      .def_readonly("name", &Law::name)
      .def_property_readonly("parameters", [](const Law& l) { return l.parameters; })
      .def_property_readonly(
          "v_f0", [](const Law& l) { return l.law->reference(); }, "Fraction of zero pressure [-].")
      .def_property_readonly(
          "limit", [](const Law& l) { return l.law->limit(); },
          "v_f must stay below this [-]; inf if nothing jams.")
      .def(
          "pressure",
          [](const Law& l, const Array& v, std::size_t threads) {
            return l.evaluate(LawQuantity::pressure, v, threads);
          },
          py::arg("v_f"), py::arg("threads") = 0, "P [Pa], compression positive.")
      .def(
          "slope",
          [](const Law& l, const Array& v, std::size_t threads) {
            return l.evaluate(LawQuantity::slope, v, threads);
          },
          py::arg("v_f"), py::arg("threads") = 0, "dP/dv_f [Pa].")
      .def(
          "energy",
          [](const Law& l, const Array& v, std::size_t threads) {
            return l.evaluate(LawQuantity::energy, v, threads);
          },
          py::arg("v_f"), py::arg("threads") = 0, "Stored energy per volume of fiber [J/m^3].")
      .def(
          "volume_fraction",
          [](const Law& l, const Array& p, double v_max) {
            Array out = same_shape(p);
            for (py::ssize_t i = 0; i < p.size(); ++i) {
              out.mutable_data()[i] = l.law->volume_fraction(p.data()[i], v_max);
            }
            return out;
          },
          py::arg("pressure"), py::arg("v_max"), "v_f at given pressure [-].")
      .def("__repr__",
           [](const Law& l) {
             std::string text = "CompressionLaw(\"" + l.name + "\"";
             for (const auto& [key, value] : l.parameters) {
               text += format(", %s=%.6g", key.c_str(), value);
             }
             return text + ")";
           })
      .def("__eq__", [](const Law& a,
                        const Law& b) { return a.name == b.name && a.parameters == b.parameters; })
      .def(py::pickle(
          [](const Law& l) { return py::make_tuple(1, l.name, l.parameters); },
          [](const py::tuple& t) {
            if (t.size() != 3 || t[0].cast<int>() != 1) {
              throw InvalidParameter("CompressionLaw pickle: unknown version, expected 1");
            }
            return Law(t[1].cast<std::string>(), t[2].cast<std::map<std::string, double>>());
          }));

  m.def(
      "run_history",
      [](const std::string& name, const std::map<std::string, std::vector<double>>& parameters,
         const Law* spring, const Array& time, const Array& x, const Array& rate) {
        const auto law = make_history_law(name, parameters, spring ? spring->law : nullptr);
        Array out = same_shape(time);
        const std::span<double> target(out.mutable_data(), static_cast<std::size_t>(out.size()));
        {
          const feltmb::python::WithoutInterpreter release;
          run_history(*law, view(time), view(x), view(rate), target);
        }
        return out;
      },
      py::arg("name"), py::arg("parameters"), py::arg("spring").none(true), py::arg("time"),
      py::arg("x"), py::arg("rate"));

  m.def(
      "compress_energy",
      [](const std::string& scheme, const Array& strain, double modulus, double v_f0,
         double chord_ratio, double ratio, double length_shape, double slip_stress) {
        const EnergyParams p{modulus, v_f0, chord_ratio, ratio, length_shape, slip_stress};
        const CompressionScheme s = scheme_of(scheme);
        constexpr py::ssize_t kColumns = 11;
        Array out({strain.size(), kColumns});
        double* row = out.mutable_data();
        const feltmb::python::WithoutInterpreter release;
        for (double value : view(strain)) {
          const EnergyState e = compress_energy(p, s, value);
          for (double number : {e.strain, e.lateral_stretch, e.v_f, e.pressure, e.bending,
                                e.straightening, e.slipping, e.slip_work, e.bending_share,
                                e.straightening_share, e.slipping_share}) {
            *row++ = number;
          }
        }
        return out;
      },
      py::arg("scheme"), py::arg("strain"), py::kw_only(), py::arg("E"), py::arg("v_f0"),
      py::arg("chord_ratio"), py::arg("ratio"), py::arg("length_shape"), py::arg("slip_stress"));

  m.def(
      "granular_stress_path",
      [](const std::vector<Eigen::Matrix3d>& path, double v_random, double modulus, double k_b,
         double k_t, double beta, bool transverse, std::size_t substeps, std::size_t nodes) {
        const GranularParams p{modulus, k_b, k_t, beta, transverse};
        std::vector<Eigen::Matrix3d> stress;
        {
          const feltmb::python::WithoutInterpreter release;
          stress = granular_stress_path(p, v_random, path, substeps, nodes);
        }
        Array out({static_cast<py::ssize_t>(stress.size()), py::ssize_t{3}, py::ssize_t{3}});
        double* target = out.mutable_data();
        for (const Eigen::Matrix3d& s : stress) {
          for (int i = 0; i < 9; ++i) *target++ = s(i / 3, i % 3);
        }
        return out;
      },
      py::arg("path"), py::arg("v_random"), py::kw_only(), py::arg("E"), py::arg("k_b"),
      py::arg("k_t"), py::arg("beta"), py::arg("transverse"), py::arg("substeps"),
      py::arg("nodes"));
}

template <class T>
py::array_t<T> array_of(const std::vector<T>& v) {
  return py::array_t<T>(static_cast<py::ssize_t>(v.size()), v.data());
}

void bind_simulation(py::module_& m) {
  py::class_<BeadSpringParams>(m, "BeadSpringParams", "Fibers, material and numerics; SI units.")
      .def(py::init([](std::size_t n_fibers, std::size_t n_beads, double d_f, double segment_length,
                       double v_f, double crimp, double ratio, std::uint64_t seed, double modulus,
                       double density, const std::string& repulsion, double interaction,
                       double friction, double tangential, double drag, double time_step) {
             if (repulsion != "hertz" && repulsion != "logarithmic") {
               throw InvalidParameter("bead-spring network: repulsion = \"" + repulsion +
                                      "\", must be one of hertz, logarithmic");
             }
             const BeadSpringParams p{
                 n_fibers,
                 n_beads,
                 d_f,
                 segment_length,
                 v_f,
                 crimp,
                 ratio,
                 seed,
                 modulus,
                 density,
                 repulsion == "hertz" ? Repulsion::hertz : Repulsion::logarithmic,
                 interaction,
                 friction,
                 tangential,
                 drag,
                 time_step};
             validate(p);
             return p;
           }),
           py::kw_only(), py::arg("n_fibers"), py::arg("n_beads"), py::arg("d_f"),
           py::arg("segment_length"), py::arg("v_f"), py::arg("crimp"), py::arg("ratio"),
           py::arg("seed"), py::arg("E"), py::arg("density"), py::arg("repulsion"),
           py::arg("interaction"), py::arg("friction"), py::arg("tangential"), py::arg("drag"),
           py::arg("time_step"));

  py::class_<BeadSpringNetwork>(m, "BeadSpringNetwork", "A periodic box of bead-spring fibers.")
      .def(py::init<const BeadSpringParams&, std::size_t>(), py::arg("params"),
           py::arg("threads") = 0)
      .def(py::init([](const BeadSpringParams& params, const py::dict& d, std::size_t threads) {
             BeadSpringState s;
             s.positions = d["positions"].cast<std::vector<double>>();
             s.velocities = d["velocities"].cast<std::vector<double>>();
             s.rest_angles = d["rest_angles"].cast<std::vector<double>>();
             s.box = d["box"].cast<std::vector<double>>();
             s.books = d["books"].cast<std::vector<double>>();
             s.contact_pairs = d["contact_pairs"].cast<std::vector<std::int64_t>>();
             s.contact_springs = d["contact_springs"].cast<std::vector<double>>();
             return std::make_unique<BeadSpringNetwork>(params, s, threads);
           }),
           py::arg("params"), py::arg("state"), py::arg("threads") = 0)
      .def("relax", &BeadSpringNetwork::relax, py::arg("steps"),
           py::call_guard<feltmb::python::WithoutInterpreter>())
      .def("advance", &BeadSpringNetwork::advance, py::arg("steps"), py::arg("strain_per_step"),
           py::call_guard<feltmb::python::WithoutInterpreter>())
      .def("sample",
           [](BeadSpringNetwork& n) {
             const BeadSpringSample s = n.sample();
             py::dict d;
             d["step"] = s.step;
             d["v_f"] = s.v_f;
             d["strain"] = s.strain;
             d["pressure"] = s.pressure;
             d["lateral"] = s.lateral;
             d["stretching"] = s.stretching;
             d["bending"] = s.bending;
             d["repulsion"] = s.repulsion;
             d["tangential"] = s.tangential;
             d["kinetic"] = s.kinetic;
             d["work"] = s.work;
             d["friction_loss"] = s.friction_loss;
             d["drag_loss"] = s.drag_loss;
             d["contacts"] = s.contacts;
             d["smallest_distance"] = s.smallest_distance;
             d["max_force"] = s.max_force;
             return d;
           })
      .def("state",
           [](const BeadSpringNetwork& n) {
             const BeadSpringState s = n.state();
             py::dict d;
             d["positions"] = array_of(s.positions);
             d["velocities"] = array_of(s.velocities);
             d["rest_angles"] = array_of(s.rest_angles);
             d["box"] = array_of(s.box);
             d["books"] = array_of(s.books);
             d["contact_pairs"] = array_of(s.contact_pairs);
             d["contact_springs"] = array_of(s.contact_springs);
             return d;
           })
      .def("crossings", &BeadSpringNetwork::crossings)
      .def("densest", &BeadSpringNetwork::densest)
      .def("directions", &BeadSpringNetwork::directions)
      .def("free_lengths", [](BeadSpringNetwork& n) { return array_of(n.free_lengths()); })
      .def("energy_and_forces", [](BeadSpringNetwork& n) {
        std::vector<double> forces;
        const double energy = n.energy_and_forces(forces);
        return py::make_tuple(energy, array_of(forces));
      });
}

SlidingNetwork network_of(double mu, double Wf0, double d_f, double v_f0, double gamma, double Q) {
  return {mu, Wf0, d_f, v_f0, gamma, Q};
}

FrictionForm form_of(const std::string& name) {
  if (name == "repaired") return FrictionForm::repaired;
  if (name == "printed") return FrictionForm::printed;
  throw InvalidParameter("carnaby_pan: form = \"" + name + "\", must be repaired or printed");
}

Stress stress_of(const std::string& name) {
  if (name == "elastic") return Stress::elastic;
  if (name == "loading") return Stress::loading;
  if (name == "unloading") return Stress::unloading;
  throw InvalidParameter("sliding: kind = \"" + name +
                         "\", must be one of elastic, loading, unloading");
}

py::dict loop_dict(const CarnabyPanLoop& loop) {
  const auto array = [](const std::vector<double>& v) {
    return Array(static_cast<py::ssize_t>(v.size()), v.data());
  };
  py::dict out;
  out["v_f"] = array(loop.v_f);
  out["C"] = array(loop.C);
  out["theta_cr"] = array(loop.theta_cr);
  out["r_sc"] = array(loop.r_sc);
  out["C_s_loading"] = array(loop.C_s_loading);
  out["C_s_unloading"] = array(loop.C_s_unloading);
  out["sigma_el"] = array(loop.sigma_el);
  out["P_loading"] = array(loop.P_loading);
  out["P_unloading"] = array(loop.P_unloading);
  return out;
}

/// Columns C, theta_cr, r_sc, C_s_loading, C_s_unloading, sigma, tau_loading, tau_unloading,
/// unique.
template <class F>
Array sliding_rows(const Array& v, const Array& x, F&& at) {
  if (v.size() != x.size()) {
    throw InvalidParameter(format("sliding: %zd volume fractions and %zd values, expected as many",
                                  static_cast<std::ptrdiff_t>(v.size()),
                                  static_cast<std::ptrdiff_t>(x.size())));
  }
  Array out({v.size(), py::ssize_t{9}});
  double* row = out.mutable_data();
  const feltmb::python::WithoutInterpreter release;
  for (py::ssize_t i = 0; i < v.size(); ++i, row += 9) {
    bool unique = true;
    const Sliding s = at(v.data()[i], x.data()[i], unique);
    const double values[] = {s.C,           s.theta_cr,      s.r_sc,
                             s.C_s_loading, s.C_s_unloading, s.sigma,
                             s.tau_loading, s.tau_unloading, unique ? 1.0 : 0.0};
    std::copy(std::begin(values), std::end(values), row);
  }
  return out;
}

void bind_friction(py::module_& m) {
  m.def(
      "carnaby_pan",
      [](const Array& v_f, double mu, double Wf0, double E, double d_f, double v_f0, double gamma,
         double k_bend, double Q, const std::string& form) {
        return loop_dict(carnaby_pan(network_of(mu, Wf0, d_f, v_f0, gamma, Q), E, k_bend, view(v_f),
                                     form_of(form)));
      },
      py::arg("v_f"), py::arg("mu"), py::arg("Wf0"), py::arg("E"), py::arg("d_f"), py::arg("v_f0"),
      py::arg("gamma"), py::arg("k_bend"), py::arg("Q"), py::arg("form"));
  m.def(
      "carnaby_pan_march",
      [](const Array& C, double mu, double Wf0, double E, double d_f, double v_f0, double gamma,
         double k_bend, double Q, const std::string& form, int substeps) {
        return loop_dict(carnaby_pan_march(network_of(mu, Wf0, d_f, v_f0, gamma, Q), E, k_bend,
                                           view(C), substeps, form_of(form)));
      },
      py::arg("C"), py::arg("mu"), py::arg("Wf0"), py::arg("E"), py::arg("d_f"), py::arg("v_f0"),
      py::arg("gamma"), py::arg("k_bend"), py::arg("Q"), py::arg("form"), py::arg("substeps"));
  m.def("critical_angle", py::vectorize(critical_angle), py::arg("w"), py::arg("mu"));
  m.def("sliding_proportion", py::vectorize(sliding_proportion), py::arg("ratio"),
        py::arg("theta"));
  m.def("sliding_resistance", py::vectorize(sliding_resistance), py::arg("ratio"), py::arg("mu"),
        py::arg("theta"));
  m.def("unloading_is_unique", py::vectorize(unloading_is_unique), py::arg("ratio"), py::arg("mu"));
  m.def(
      "sliding_at_force",
      [](const Array& v_f, const Array& C, double mu, double Wf0, double d_f, double v_f0,
         double gamma, double Q) {
        const SlidingNetwork network = network_of(mu, Wf0, d_f, v_f0, gamma, Q);
        validate(network, "sliding");
        return sliding_rows(
            v_f, C, [&](double v, double c, bool&) { return sliding_at_force(network, v, c); });
      },
      py::arg("v_f"), py::arg("C"), py::arg("mu"), py::arg("Wf0"), py::arg("d_f"), py::arg("v_f0"),
      py::arg("gamma"), py::arg("Q"));
  m.def(
      "sliding_at_pressure",
      [](const Array& v_f, const Array& pressure, const std::string& kind, double mu, double Wf0,
         double d_f, double v_f0, double gamma, double Q) {
        const SlidingNetwork network = network_of(mu, Wf0, d_f, v_f0, gamma, Q);
        validate(network, "sliding");
        const Stress stress = stress_of(kind);
        return sliding_rows(v_f, pressure, [&](double v, double p, bool& unique) {
          return sliding_at_pressure(network, v, p, stress, &unique);
        });
      },
      py::arg("v_f"), py::arg("pressure"), py::arg("kind"), py::arg("mu"), py::arg("Wf0"),
      py::arg("d_f"), py::arg("v_f0"), py::arg("gamma"), py::arg("Q"));
}

}  // namespace

}  // namespace feltmb::python

void bind_fiber(py::module_& m) {
  py::module_ fiber = m.def_submodule("fiber", "Micromechanics of fiber networks.");
  feltmb::python::bind_orientation(fiber);
  feltmb::python::bind_contacts(fiber);
  feltmb::python::bind_laws(fiber);
  feltmb::python::bind_friction(fiber);
  feltmb::python::bind_simulation(fiber);
}
