// Benchmarks of feltmb: strokes of the upright action, one right-hand side, hammer on string.
// No Python. See README.md beside this file.

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <ctime>
#include <fstream>
#include <functional>
#include <sstream>
#include <string>
#include <thread>
#include <tuple>
#include <vector>

#include "feltmb/core/error.hpp"
#include "feltmb/modal/contact_stepper.hpp"
#include "feltmb/model/equilibrium.hpp"
#include "feltmb/model/simulation.hpp"
#include "steinway45.hpp"

namespace {

using feltmb::RunResult;
/// Wall time, or with --cpu the CPU time of this program.
struct Clock {
  using duration = std::chrono::nanoseconds;
  using rep = duration::rep;
  using period = duration::period;
  using time_point = std::chrono::time_point<Clock>;
  static constexpr bool is_steady = true;
  static inline bool cpu = false;
  static time_point now() {
    const auto wall = std::chrono::steady_clock::now().time_since_epoch();
    const double seconds = static_cast<double>(std::clock()) / CLOCKS_PER_SEC;
    return time_point(cpu ? duration(static_cast<rep>(1e9 * seconds))
                          : std::chrono::duration_cast<duration>(wall));
  }
};

struct CaseResult {
  std::string name;
  std::vector<double> milliseconds;
  long steps = 0, rhs = 0, jacobians = 0, factorizations = 0;
  std::vector<std::pair<std::string, double>> errors;
  std::uint64_t checksum = 0;
};

double quantile(std::vector<double> values, double p) {
  std::sort(values.begin(), values.end());
  const double at = p * static_cast<double>(values.size() - 1);
  const auto low = static_cast<std::size_t>(at);
  const auto high = std::min(low + 1, values.size() - 1);
  return values[low] + (at - static_cast<double>(low)) * (values[high] - values[low]);
}

/// FNV-1a over the bytes of the doubles: changes if any bit of the result does.
std::uint64_t checksum(const double* values, std::size_t count) {
  std::uint64_t hash = 1469598103934665603ULL;
  const auto* bytes = reinterpret_cast<const unsigned char*>(values);
  for (std::size_t i = 0; i < count * sizeof(double); ++i) {
    hash = (hash ^ bytes[i]) * 1099511628211ULL;
  }
  return hash;
}

feltmb::InputSignal ramp(double force, double start, double rise) {
  return {feltmb::Profile({start, start + rise}, {0.0, force},
                          feltmb::Profile::Interpolation::kLinear)};
}

feltmb::InputSignal pulse(double force, double start, double half) {
  return {feltmb::Profile({start, start + half, start + 2 * half}, {0.0, force, 0.0},
                          feltmb::Profile::Interpolation::kLinear)};
}

void take_counts(CaseResult& out, const RunResult& run) {
  out.steps = run.counts.steps;
  out.rhs = run.counts.rhs;
  out.jacobians = run.counts.jacobians;
  out.factorizations = run.counts.factorizations;
  out.checksum = checksum(run.end.y.data(), run.end.y.size());
}

double impact_speed(const RunResult& run, int contact) {
  for (std::size_t i = 0; i < run.events.size(); ++i) {
    if (run.events[i].contact == contact && run.events[i].direction > 0) {
      return run.event_approach(static_cast<Eigen::Index>(i), contact);
    }
  }
  return std::nan("");
}

enum class Members { kRigid, kFlexible, kFlexibleFullAxial };

feltmb::MechanismDescription action(Members members) {
  auto description = feltmb::bench::steinway45(members != Members::kRigid);
  for (auto& body : description.bodies) {
    if (body.beam) body.beam->condense_axial = members == Members::kFlexible;
  }
  return description;
}

CaseResult stroke(const std::string& name, Members members, const feltmb::InputSignal& input,
                  double duration, bool outputs, int repeat,
                  feltmb::Method method = feltmb::Method::kAuto) {
  const auto mechanism = feltmb::assemble(action(members));
  const int contact = mechanism->contact_index(6);
  feltmb::SimulationOptions options;
  options.duration = duration;
  options.ledger = outputs;
  options.outputs = outputs;
  options.method = method;
  options.diagnose = false;
  options.peak_contacts = {6};
  CaseResult out;
  out.name = name;
  RunResult run;
  for (int i = 0; i < repeat; ++i) {
    const auto begin = Clock::now();
    run = feltmb::simulate(mechanism, input, options);
    out.milliseconds.push_back(
        std::chrono::duration<double, std::milli>(Clock::now() - begin).count());
  }
  take_counts(out, run);
  feltmb::SimulationOptions fine = options;
  fine.rtol = 1e-10;
  fine.method = feltmb::Method::kCvode;
  fine.outputs = false;
  fine.ledger = false;
  const RunResult reference = feltmb::simulate(mechanism, input, fine);
  const double speed = impact_speed(reference, contact);
  out.errors = {
      {"impact_speed_rel", std::fabs(impact_speed(run, contact) / speed - 1.0)},
      {"string_force_rel", std::fabs(run.peaks[0].force / reference.peaks[0].force - 1.0)}};
  return out;
}

/// A stroke of 0.4 s, timed without a reference.
CaseResult timed_stroke(const std::string& name, const feltmb::MechanismDescription& description,
                        const feltmb::InputSignal& input, feltmb::Method method, int repeat) {
  const auto mechanism = feltmb::assemble(description);
  feltmb::SimulationOptions options;
  options.ledger = options.outputs = options.diagnose = false;
  options.method = method;
  CaseResult out;
  out.name = name;
  RunResult run;
  for (int i = 0; i < repeat; ++i) {
    const auto begin = Clock::now();
    run = feltmb::simulate(mechanism, input, options);
    out.milliseconds.push_back(
        std::chrono::duration<double, std::milli>(Clock::now() - begin).count());
  }
  take_counts(out, run);
  return out;
}

/// Levers side by side, each with a spring, and `contacts` closed felts between them and the
/// ground: one right-hand side.
CaseResult sized_evaluation(const std::string& name, int bodies, int contacts, int repeat) {
  using namespace feltmb;
  MechanismDescription d;
  d.name = name;
  for (int b = 0; b < bodies; ++b) {
    BodyDescription body;
    body.name = "lever" + std::to_string(b);
    body.position = {0.2 * b, 0.0};
    body.coordinate = body.name + ".angle";
    body.mass = 0.01;
    body.center_of_mass = {0.05, 0.0};
    body.inertia = 1e-5;
    d.bodies.push_back(body);
    d.springs.push_back({"spring" + std::to_string(b), body.coordinate, 0.5, 0.0});
  }
  SurfaceDescription floor;
  floor.name = "floor";
  floor.body = "ground";
  floor.kind = SurfaceKind::kLine;
  d.surfaces.push_back(floor);
  for (int c = 0; c < contacts; ++c) {
    SurfaceDescription foot;
    foot.name = "foot" + std::to_string(c);
    foot.body = "lever" + std::to_string(c % bodies);
    foot.point = {0.02 + 0.001 * c, 0.0};
    foot.radius = 5e-4;
    d.surfaces.push_back(foot);
    ContactDescription contact;
    contact.number = c + 1;
    contact.surface_a = "floor";
    contact.surface_b = foot.name;
    contact.law = ExponentialPair{{5.52e3, 1.58e3, -0.60e3}, {0.19e3, 5.04e3, 3.04e3}};
    contact.friction = feltmb::coulomb(0.3, 0.7, 0.5, 1e-3);
    d.contacts.push_back(contact);
  }
  const auto mechanism = assemble(d);
  MechanismSystem system(mechanism, {Profile()}, false, {}, false);
  std::vector<double> y(system.size(), 0.0), rate(system.size());
  for (int b = 0; b < bodies; ++b) {
    y[static_cast<std::size_t>(b)] = 1e-3 * b;
    y[static_cast<std::size_t>(bodies + b)] = -0.1 - 0.01 * b;
  }
  CaseResult out;
  out.name = name;
  double sum = 0.0;
  constexpr int count = 2000;
  for (int i = 0; i < repeat; ++i) {
    const auto begin = Clock::now();
    for (int j = 0; j < count; ++j) {
      y[0] = 1e-6 * j;
      system.rhs(0.0, y, rate);
      sum += rate[static_cast<std::size_t>(bodies)];
    }
    out.milliseconds.push_back(
        std::chrono::duration<double, std::milli>(Clock::now() - begin).count() / count);
  }
  out.checksum = checksum(&sum, 1);
  return out;
}

/// Time of one evaluation at states along the forte stroke.
CaseResult evaluation(bool flexible, const std::string& what, int repeat) {
  const auto mechanism = feltmb::assemble(feltmb::bench::steinway45(flexible));
  const feltmb::InputSignal input = ramp(25.0, 0.05, 0.0905);
  feltmb::SimulationOptions options;
  options.output_rate = 1000.0;
  options.ledger = false;
  const RunResult run = feltmb::simulate(mechanism, input, options);
  feltmb::MechanismSystem system(mechanism, input, false, {}, false);
  std::vector<double> rate(system.size());
  const auto rows = static_cast<std::size_t>(run.states.rows());
  CaseResult out;
  out.name = std::string(flexible ? "flexible_" : "rigid_") + what;
  double sum = 0.0;
  for (int i = 0; i < repeat; ++i) {
    const auto begin = Clock::now();
    for (std::size_t r = 0; r < rows; ++r) {
      const auto row = static_cast<Eigen::Index>(r);
      const std::span<const double> y{run.states.row(row).data(), system.size()};
      if (what != "rhs") {
        if (what == "jacobian") {
          system.linearize(run.time[row], y);
        } else {
          system.linearize_stiff(run.time[row], y);
        }
        system.factorize(1e-5);
      } else {
        system.rhs(run.time[row], y, rate);
        sum += rate[static_cast<std::size_t>(mechanism->size())];
      }
    }
    out.milliseconds.push_back(
        std::chrono::duration<double, std::milli>(Clock::now() - begin).count() /
        static_cast<double>(rows));
  }
  out.checksum = checksum(&sum, 1);
  return out;
}

/// Time of one force of a contact law along compressions inside its window.
CaseResult law_evaluation(const std::string& name, const feltmb::LawParameters& parameters,
                          double largest, int repeat) {
  const feltmb::ContactLaw law(parameters);
  constexpr int count = 100000;
  CaseResult out;
  out.name = "law_" + name;
  double state[feltmb::kMaxLawStates] = {0.3, 0.0, 0.0};
  double sum = 0.0;
  for (int i = 0; i < repeat; ++i) {
    const auto begin = Clock::now();
    for (int j = 0; j < count; ++j) {
      const double e = largest * (0.05 + 0.9 * ((j * 7919) % count) / count);
      sum += law.evaluate(e, (j & 1) != 0 ? 0.1 : -0.1, {state, largest}).force;
    }
    out.milliseconds.push_back(
        std::chrono::duration<double, std::milli>(Clock::now() - begin).count() / count);
  }
  out.checksum = checksum(&sum, 1);
  return out;
}

/// One stroke under several contact laws, taken in turn so that the load of the machine is shared.
std::vector<CaseResult> law_strokes(const std::string& name, const feltmb::InputSignal& input,
                                    double duration, int repeat, const std::string& filter) {
  using feltmb::ExponentialPair;
  const auto felts = feltmb::bench::felts();
  const auto memory = [](std::shared_ptr<const feltmb::Envelope> envelope) {
    feltmb::FeltMemory law;
    law.envelope = std::move(envelope);
    return law;
  };
  std::vector<CaseResult> out;
  std::vector<std::shared_ptr<const feltmb::Mechanism>> mechanisms;
  for (const char* kind : {"printed", "felt_memory", "micromechanical_hammer", "micromechanical"}) {
    const std::string law = kind;
    if ((name + "_" + law).find(filter) == std::string::npos) continue;
    auto description = action(Members::kFlexible);
    for (auto& contact : description.contacts) {
      const auto& pair = std::get<ExponentialPair>(contact.law);
      if (law == "felt_memory") {
        // The printed row of contact 2 never closes; its loop ends at 2.6 mm.
        contact.law = memory(feltmb::Envelope::from_curves(pair.loading, pair.unloading,
                                                           contact.number == 2 ? 2.6e-3 : 0.0));
      } else if (law == "micromechanical" || (law != "printed" && contact.number == 6)) {
        contact.law = memory(feltmb::layer_envelope(felts.at(contact.number)));
      } else {
        contact.law = ExponentialPair{
            pair.loading, pair.unloading, pair.alpha,
            law == "printed" ? ExponentialPair::Form::kPrinted : ExponentialPair::Form::kGuarded};
      }
    }
    mechanisms.push_back(feltmb::assemble(description));
    out.emplace_back();
    out.back().name = name + "_" + law;
  }
  feltmb::SimulationOptions options;
  options.duration = duration;
  options.ledger = false;
  options.outputs = false;
  options.diagnose = false;
  for (int i = 0; i < repeat; ++i) {
    for (std::size_t k = 0; k < out.size(); ++k) {
      const auto begin = Clock::now();
      const RunResult run = feltmb::simulate(mechanisms[k], input, options);
      out[k].milliseconds.push_back(
          std::chrono::duration<double, std::milli>(Clock::now() - begin).count());
      take_counts(out[k], run);
    }
  }
  return out;
}

/// Time to make the tables of one felt and of one contact; never the same felt twice.
CaseResult table_build(const std::string& name, bool contact, feltmb::LayerCompression compression,
                       int repeat) {
  feltmb::FeltMaterial felt = {0.35, 2.5, 25e-6, 0.389, 0.60, 2.0, {2.0e6, 1.1}, {5.39e4, 2.536}};
  CaseResult out;
  out.name = "table_" + name;
  double sum = 0.0;
  for (int i = 0; i < repeat; ++i) {
    felt.loading.K_p *=
        1.0 + 1e-6 * (1 + static_cast<int>(contact) + 2 * static_cast<int>(compression));
    const auto begin = Clock::now();
    auto made = feltmb::pressure_envelope(felt);
    if (contact) {
      made = feltmb::layer_envelope(
          {made, 6e-3, feltmb::CrossedCylinders{12.3e-3, 0.495e-3}, compression});
    }
    out.milliseconds.push_back(
        std::chrono::duration<double, std::milli>(Clock::now() - begin).count());
    sum += made->loading(0.2 * made->closing()).force;
  }
  out.checksum = checksum(&sum, 1);
  return out;
}

struct Reference {
  std::vector<double> x, force;
};

Reference read_reference(const std::string& path) {
  std::ifstream in(path);
  if (!in) throw feltmb::Error("bench: cannot read " + path);
  Reference out;
  std::string line;
  std::getline(in, line);
  while (std::getline(in, line)) {
    double t = 0, x = 0, v = 0, xs = 0, f = 0;
    if (std::sscanf(line.c_str(), "%lf,%lf,%lf,%lf,%lf", &t, &x, &v, &xs, &f) != 5) {
      throw feltmb::Error("bench: bad line in " + path + ": " + line);
    }
    out.x.push_back(x);
    out.force.push_back(f);
  }
  return out;
}

feltmb::MechanismDescription hammer_on_string(int modes, double damping) {
  using namespace feltmb;
  MechanismDescription d;
  d.name = "hammer_on_string";
  d.gravity = {0.0, 0.0};
  BodyDescription hammer;
  hammer.name = "hammer";
  hammer.joint = JointKind::kPrismatic;
  hammer.axis = {1.0, 0.0};
  hammer.coordinate = "hammer.x";
  hammer.mass = 9e-3;
  d.bodies.push_back(hammer);
  SurfaceDescription line;
  line.name = "string";
  line.body = "ground";
  line.kind = SurfaceKind::kLine;
  line.normal = {-1.0, 0.0};
  SurfaceDescription nose;
  nose.name = "nose";
  nose.body = "hammer";
  d.surfaces = {line, nose};
  ContactDescription contact;
  contact.number = 6;
  contact.surface_a = "string";
  contact.surface_b = "nose";
  contact.law = ExponentialPair{
      {2.35e4, 1.74e3, -2.41e4}, {2.0e3, 4.52e3, -0.82e3}, 10.0, ExponentialPair::Form::kPrinted};
  d.contacts.push_back(contact);
  StringDescription string;
  string.surface = "string";
  string.parameters = {0.99e-3, 654.0, 0.6315, 5.98e-3, 2e11, damping, modes};
  string.moving_strike_point = false;
  string.strike_position = 0.6315 / 8.0;
  d.strings.push_back(string);
  return d;
}

/// Largest errors of x and F against the reference, and over what they are counted.
void compare(CaseResult& out, const Reference& reference, const std::vector<double>& x,
             const std::vector<double>& force) {
  double error_x = 0.0, error_f = 0.0, top = 0.0;
  for (std::size_t i = 0; i < reference.x.size(); ++i) {
    error_x = std::max(error_x, std::fabs(x[i] - reference.x[i]));
    error_f = std::max(error_f, std::fabs(force[i] - reference.force[i]));
    top = std::max(top, reference.force[i]);
  }
  out.errors = {{"position_m", error_x}, {"force_rel", error_f / top}};
}

struct LawForce : feltmb::modal::ScalarForce {
  feltmb::ContactLaw law;
  explicit LawForce(const feltmb::LawParameters& p) : law(p) {}
  Value trial(int, double, double compression, double rate) override {
    const feltmb::LawValue v = law.evaluate(compression, rate);
    return {v.force, v.d_compression, v.d_rate};
  }
};

/// Problem H by the exact modal stepper: shapes, tables, 50 ms and 1001 samples, all timed.
CaseResult exact_h(int modes, double damping, double tolerance, const std::string& folder,
                   int repeat) {
  const auto d = hammer_on_string(modes, damping);
  const double root_mass = std::sqrt(d.bodies[0].mass);
  CaseResult out;
  out.name = feltmb::format("H_exact_N%d_xi%g_tol%g", modes, damping, tolerance);
  std::vector<double> x(1001), v(1001), force(1001), string(1001);
  for (int i = 0; i < repeat; ++i) {
    const auto begin = Clock::now();
    const feltmb::ModalString s(d.strings[0].parameters);
    std::vector<double> stiffness(s.stiffness().begin(), s.stiffness().end());
    std::vector<double> losses(s.damping().begin(), s.damping().end());
    std::vector<double> gradient(stiffness.size()), slope(stiffness.size());
    s.shapes(d.strings[0].strike_position, gradient, slope);
    for (double& g : gradient) g = -g;
    stiffness.push_back(0.0);
    losses.push_back(0.0);
    gradient.push_back(1.0 / root_mass);
    LawForce law(d.contacts[0].law);
    feltmb::modal::ModalStepperOptions options;
    options.tolerance = tolerance;
    feltmb::modal::ModalContactStepper stepper(stiffness, losses, {{gradient, 0.0, &law}}, {},
                                               options);
    const std::vector<double> rest(stiffness.size(), 0.0);
    std::vector<double> speed(stiffness.size(), 0.0);
    speed.back() = 3.0 * root_mass;
    stepper.start(0.0, rest, speed);
    for (std::size_t k = 0; k < x.size(); ++k) {
      if (k > 0) stepper.advance();
      x[k] = stepper.position().back() / root_mass;
      v[k] = stepper.velocity().back() / root_mass;
      force[k] = stepper.force(0);
      string[k] = x[k] - stepper.compression(0);
    }
    out.milliseconds.push_back(
        std::chrono::duration<double, std::milli>(Clock::now() - begin).count());
    out.steps = stepper.counts().steps;
    out.rhs = stepper.counts().forces;
  }
  out.checksum = checksum(string.data(), string.size());
  compare(out, read_reference(folder + feltmb::format("/ref_N%d_xi%g.csv", modes, damping)), x,
          force);
  return out;
}

CaseResult problem_h(int modes, double damping, double rtol, const std::string& folder, int repeat,
                     feltmb::Method method) {
  const auto mechanism = feltmb::assemble(hammer_on_string(modes, damping));
  feltmb::SimulationOptions options;
  options.duration = 0.05;
  options.output_rate = 20000.0;
  options.rtol = rtol;
  options.ledger = false;
  options.events = false;
  options.diagnose = false;
  options.states = false;
  feltmb::SimulationState start;
  start.y.assign(2 + 2 * static_cast<std::size_t>(modes), 0.0);
  start.y[1] = 3.0;
  CaseResult out;
  out.name =
      feltmb::format("H_%s_N%d_xi%g_rtol%g", feltmb::method_name(method), modes, damping, rtol);
  options.method = method;
  RunResult run;
  for (int i = 0; i < repeat; ++i) {
    const auto begin = Clock::now();
    run = feltmb::simulate(mechanism, {feltmb::Profile()}, options, start);
    out.milliseconds.push_back(
        std::chrono::duration<double, std::milli>(Clock::now() - begin).count());
  }
  take_counts(out, run);
  const Reference reference =
      read_reference(folder + feltmb::format("/ref_N%d_xi%g.csv", modes, damping));
  const auto column = [&](const std::string& name) {
    const auto it = std::find(run.names.begin(), run.names.end(), name);
    return static_cast<Eigen::Index>(it - run.names.begin());
  };
  const Eigen::Index x = column("hammer.x");
  const Eigen::Index f = column("contact06.force");
  std::vector<double> position(reference.x.size()), force(reference.x.size());
  for (std::size_t i = 0; i < reference.x.size(); ++i) {
    position[i] = run.data(static_cast<Eigen::Index>(i), x);
    force[i] = run.data(static_cast<Eigen::Index>(i), f);
  }
  compare(out, reference, position, force);
  return out;
}

std::string processor() {
  std::ifstream in("/proc/cpuinfo");
  std::string line;
  while (std::getline(in, line)) {
    if (line.rfind("model name", 0) == 0) return line.substr(line.find(':') + 2);
  }
  return "unknown";
}

void print(const CaseResult& r) {
  const double median = quantile(r.milliseconds, 0.5);
  const bool small = median < 0.1;
  const double scale = small ? 1e3 : 1.0;
  std::printf("%-26s %9.4g %s [%.4g, %.4g]", r.name.c_str(), median * scale, small ? "us" : "ms",
              quantile(r.milliseconds, 0.25) * scale, quantile(r.milliseconds, 0.75) * scale);
  if (r.steps > 0) {
    std::printf("  %ld steps, %ld rhs, %ld jac, %ld fact", r.steps, r.rhs, r.jacobians,
                r.factorizations);
  }
  for (const auto& [name, value] : r.errors) std::printf("  %s %.2g", name.c_str(), value);
  std::printf("  #%016llx\n", static_cast<unsigned long long>(r.checksum));
  std::fflush(stdout);
}

void write_json(const std::string& path, const std::vector<CaseResult>& results) {
  std::ofstream out(path);
  if (!out) throw feltmb::Error("bench: cannot write " + path);
  out << "{\n  \"version\": \"" << FELTMB_VERSION << "\",\n  \"compiler\": \"" << FELTMB_BENCH_FLAGS
      << "\",\n  \"processor\": \"" << processor()
      << "\",\n  \"cores\": " << std::thread::hardware_concurrency() << ",\n  \"cases\": [\n";
  for (std::size_t i = 0; i < results.size(); ++i) {
    const auto& r = results[i];
    out << "    {\"name\": \"" << r.name << "\", \"median_ms\": " << quantile(r.milliseconds, 0.5)
        << ", \"best_ms\": " << quantile(r.milliseconds, 0.0)
        << ", \"quartile1_ms\": " << quantile(r.milliseconds, 0.25)
        << ", \"quartile3_ms\": " << quantile(r.milliseconds, 0.75)
        << ", \"repeats\": " << r.milliseconds.size() << ", \"steps\": " << r.steps
        << ", \"rhs\": " << r.rhs << ", \"jacobians\": " << r.jacobians
        << ", \"factorizations\": " << r.factorizations << ", \"errors\": {";
    for (std::size_t e = 0; e < r.errors.size(); ++e) {
      out << (e ? ", " : "") << "\"" << r.errors[e].first << "\": " << r.errors[e].second;
    }
    out << "}, \"checksum\": \"" << std::hex << r.checksum << std::dec << "\"}"
        << (i + 1 < results.size() ? "," : "") << "\n";
  }
  out << "  ]\n}\n";
}

}  // namespace

int main(int argc, char** argv) {
  std::string json, filter, folder = FELTMB_BENCH_REFERENCE;
  int repeat = 11;
  for (int i = 1; i < argc; ++i) {
    const auto value = [&]() -> std::string {
      if (i + 1 >= argc) {
        std::fprintf(stderr, "feltmb_bench: %s needs a value\n", argv[i]);
        std::exit(2);
      }
      return argv[++i];
    };
    const std::string option = argv[i];
    if (option == "--json")
      json = value();
    else if (option == "--case")
      filter = value();
    else if (option == "--reference")
      folder = value();
    else if (option == "--repeat")
      repeat = std::max(1, std::atoi(value().c_str()));
    else if (option == "--cpu")
      Clock::cpu = true;
    else {
      std::fprintf(stderr,
                   "usage: feltmb_bench [--case TEXT] [--repeat N] [--json FILE] "
                   "[--reference FOLDER] [--cpu]\n");
      return option == "--help" ? 0 : 2;
    }
  }
  std::printf("feltmb %s, %s, %s\n", FELTMB_VERSION, FELTMB_BENCH_FLAGS, processor().c_str());
  std::printf("median [quartiles] of %d, one thread\n", repeat);

  std::vector<std::pair<std::string, std::function<CaseResult()>>> cases;
  for (const bool flexible : {false, true}) {
    const std::string kind = flexible ? "flexible_" : "rigid_";
    const auto add = [&](const std::string& name, const feltmb::InputSignal& input, double end,
                         bool outputs) {
      cases.emplace_back(kind + name, [=] {
        return stroke(kind + name, flexible ? Members::kFlexible : Members::kRigid, input, end,
                      outputs, repeat);
      });
    };
    add("piano", flexible ? ramp(5.0, 0.083, 0.350) : ramp(5.0, 0.083, 0.3475), 0.5, false);
    const auto forte = flexible ? ramp(25.0, 0.05, 0.0930) : ramp(25.0, 0.05, 0.0905);
    add("forte", forte, 0.4, false);
    add("staccato", pulse(16.0, 0.02, 0.0125), 0.5, false);
    add("forte_outputs", forte, 0.4, true);
    cases.emplace_back(kind + "forte_cvode", [=] {
      return stroke(kind + "forte_cvode", flexible ? Members::kFlexible : Members::kRigid, forte,
                    0.4, false, repeat, feltmb::Method::kCvode);
    });
    for (const std::string what : {"rhs", "jacobian", "stiff_jacobian"}) {
      cases.emplace_back(kind + what, [=] { return evaluation(flexible, what, repeat); });
    }
  }
  cases.emplace_back("full_axial_forte", [&] {
    return stroke("full_axial_forte", Members::kFlexibleFullAxial, ramp(25.0, 0.05, 0.0930), 0.4,
                  false, std::min(repeat, 3));
  });
  const feltmb::ExponentialCurve loading{5.52e3, 1.58e3, -0.60e3};
  const feltmb::ExponentialCurve unloading{0.19e3, 5.04e3, 3.04e3};
  const auto add_law = [&](const std::string& name, const feltmb::LawParameters& parameters) {
    cases.emplace_back("law_" + name,
                       [=] { return law_evaluation(name, parameters, 8e-4, repeat); });
  };
  add_law("printed", feltmb::ExponentialPair{loading, unloading, 100.0,
                                             feltmb::ExponentialPair::Form::kPrinted});
  add_law("guarded", feltmb::ExponentialPair{loading, unloading, 100.0,
                                             feltmb::ExponentialPair::Form::kGuarded});
  feltmb::FeltMemory memory;
  memory.envelope = feltmb::Envelope::from_curves(loading, unloading);
  add_law("felt_memory", memory);
  for (const bool columns : {false, true}) {
    feltmb::FeltLayer hammer = feltmb::bench::felts().at(6);
    if (columns) hammer.compression = feltmb::LayerCompression::kColumns;
    memory.envelope = feltmb::layer_envelope(hammer);
    add_law(columns ? "micromechanical_columns" : "micromechanical", memory);
  }
  cases.emplace_back("table_felt", [&] {
    return table_build("felt", false, feltmb::LayerCompression::kEven, repeat);
  });
  cases.emplace_back("table_felt_contact", [&] {
    return table_build("felt_contact", true, feltmb::LayerCompression::kEven, repeat);
  });
  cases.emplace_back("table_felt_columns", [&] {
    return table_build("felt_columns", true, feltmb::LayerCompression::kColumns, repeat);
  });
  for (const int modes : {40, 200}) {
    for (const double damping : {0.07, 7e-4}) {
      for (const double tolerance : {1e-4, 3e-5, 1e-6}) {
        cases.emplace_back(feltmb::format("H_exact_N%d_xi%g_tol%g", modes, damping, tolerance),
                           [=] { return exact_h(modes, damping, tolerance, folder, repeat); });
      }
      for (const auto method : {feltmb::Method::kModal, feltmb::Method::kCvode}) {
        for (const double rtol : {1e-5, 1e-6}) {
          const std::string name = feltmb::format(
              "H_%s_N%d_xi%g_rtol%g", feltmb::method_name(method), modes, damping, rtol);
          cases.emplace_back(
              name, [=] { return problem_h(modes, damping, rtol, folder, repeat, method); });
        }
      }
    }
  }
  // Cost against size: modes of the string, contacts of one body, bodies of a chain.
  for (const int modes : {10, 20, 40, 80, 160, 320}) {
    for (const auto method : {feltmb::Method::kModal, feltmb::Method::kCvode}) {
      const std::string name =
          feltmb::format("size_modes_%s_%d", feltmb::method_name(method), modes);
      cases.emplace_back(name, [=] {
        auto description = action(Members::kRigid);
        description.strings[0].parameters.modes = modes;
        return timed_stroke(name, description, ramp(25.0, 0.05, 0.0905), method, repeat);
      });
    }
  }
  for (const int bodies : {2, 4, 8, 16, 32}) {
    const std::string name = feltmb::format("size_bodies_%d", bodies);
    cases.emplace_back(name, [=] { return sized_evaluation(name, bodies, 0, repeat); });
  }
  for (const int contacts : {4, 8, 16, 32, 64}) {
    const std::string name = feltmb::format("size_contacts_%d", contacts);
    cases.emplace_back(name, [=] { return sized_evaluation(name, 8, contacts, repeat); });
  }
  std::vector<CaseResult> results;
  try {
    for (const auto& [name, run] : cases) {
      if (name.find(filter) == std::string::npos) continue;
      results.push_back(run());
      print(results.back());
    }
    for (const auto& [name, input, end] :
         {std::tuple{"laws_piano", ramp(5.0, 0.083, 0.350), 0.5},
          std::tuple{"laws_forte", ramp(25.0, 0.05, 0.0930), 0.4}}) {
      const auto of_laws = law_strokes(name, input, end, repeat, filter);
      if (of_laws.empty()) continue;
      const double printed = quantile(of_laws[0].milliseconds, 0.5);
      for (const auto& r : of_laws) {
        print(r);
        results.push_back(r);
      }
      for (std::size_t k = 1; k < of_laws.size(); ++k) {
        std::printf("%s takes %.2f times %s\n", of_laws[k].name.c_str(),
                    quantile(of_laws[k].milliseconds, 0.5) / printed, of_laws[0].name.c_str());
      }
    }
    const auto median = [&](const std::string& name) {
      for (const auto& r : results) {
        if (r.name == name) return quantile(r.milliseconds, 0.5);
      }
      return std::nan("");
    };
    const double rigid = median("rigid_forte");
    for (const char* name : {"flexible_forte", "full_axial_forte"}) {
      if (std::isfinite(median(name) / rigid)) {
        std::printf("%s takes %.2f times rigid_forte\n", name, median(name) / rigid);
      }
    }
    if (!json.empty()) write_json(json, results);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "feltmb_bench: %s\n", error.what());
    return 1;
  }
  return results.empty() ? 2 : 0;
}
