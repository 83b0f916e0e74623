// Work against true error: strokes of the action under three laws, at several tolerances, against
// runs at rtol 1e-10. No Python. See README.md beside this file.

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <fstream>
#include <string>
#include <vector>

#include "feltmb/core/error.hpp"
#include "feltmb/model/simulation.hpp"
#include "steinway45.hpp"

namespace {

using namespace feltmb;

constexpr int kStrokes = 10;
constexpr double kRate = 4000.0;  // samples a second [Hz]

struct Case {
  std::string name;
  std::shared_ptr<const Mechanism> mechanism;
  std::vector<InputSignal> inputs;
};

InputSignal ramp(double force, double start, double rise) {
  return {Profile({start, start + rise}, {0.0, force}, Profile::Interpolation::kLinear)};
}

/// The quantities that are compared of one run.
struct Trace {
  Eigen::MatrixXd place;  ///< of the hammer before its string and of the key's front [m], by sample
  Eigen::MatrixXd force;  ///< of all contacts [N], by sample
  double impact = NAN, impact_speed = NAN, let_off = NAN, peak = NAN;
};

Trace trace_of(const Mechanism& m, const RunResult& run) {
  Trace out;
  std::vector<Eigen::Index> places, forces;
  for (std::size_t i = 0; i < run.names.size(); ++i) {
    const std::string& name = run.names[i];
    const auto column = static_cast<Eigen::Index>(i);
    if (name == "contact06.compression" || name == "finger.displacement") places.push_back(column);
    if (name.starts_with("contact") && name.ends_with(".force")) forces.push_back(column);
  }
  out.place = run.data(Eigen::indexing::all, places);
  out.force = run.data(Eigen::indexing::all, forces);
  const int string = m.contact_index(6);
  const int button = m.contact_index(5);
  for (std::size_t i = 0; i < run.events.size(); ++i) {
    const auto& event = run.events[i];
    if (event.contact == string && event.direction > 0 && std::isnan(out.impact)) {
      out.impact = event.time;
      out.impact_speed = run.event_approach(static_cast<Eigen::Index>(i), string);
    }
    if (event.contact == button && event.direction > 0 && std::isnan(out.let_off)) {
      out.let_off = event.time;
    }
  }
  out.peak = run.peaks[0].force;
  return out;
}

/// Largest error of a place up to the impact and over all [m]; forces, root mean square over
/// samples and contacts, over the largest force; impact speed; largest string force; times of
/// impact and let-off [s].
constexpr std::size_t kErrors = 6;
constexpr const char* kErrorNames[kErrors] = {"before/m", "all/m", "forces",
                                              "speed",    "peak",  "times/s"};
using Errors = std::array<double, kErrors>;

Errors compare(const Trace& a, const Trace& b) {
  const Eigen::MatrixXd place = (a.place - b.place).cwiseAbs();
  const auto before = static_cast<Eigen::Index>(b.impact * kRate);
  double time = std::fabs(a.impact - b.impact);
  if (std::isfinite(b.let_off)) time = std::max(time, std::fabs(a.let_off - b.let_off));
  return {place.topRows(before).maxCoeff(),
          place.maxCoeff(),
          std::sqrt((a.force - b.force).array().square().mean()) / b.force.cwiseAbs().maxCoeff(),
          std::fabs(a.impact_speed / b.impact_speed - 1.0),
          std::fabs(a.peak / b.peak - 1.0),
          time};
}

/// Towards the geometric mean, which one odd stroke does not rule, and the root mean square.
void add(const Errors& e, double count, Errors& logs, Errors& squares) {
  for (std::size_t i = 0; i < kErrors; ++i) {
    logs[i] += std::log(std::max(e[i], 1e-12)) / count;
    squares[i] += e[i] * e[i] / count;
  }
}

SimulationOptions options(double rtol) {
  SimulationOptions o;
  o.duration = 0.4;
  o.rtol = rtol;
  o.output_rate = kRate;
  o.ledger = false;
  o.diagnose = false;
  o.states = false;
  o.peak_contacts = {6};
  return o;
}

std::vector<Case> cases(const std::string& filter) {
  std::vector<Case> out;
  const auto felts = bench::felts();
  const auto memory = [](std::shared_ptr<const Envelope> envelope) {
    FeltMemory law;
    law.envelope = std::move(envelope);
    return law;
  };
  for (const bool flexible : {true, false}) {
    for (const bool forte : {true, false}) {
      for (const std::string law : {"printed", "felt_memory", "micromechanical"}) {
        const std::string name =
            std::string(flexible ? "flexible" : "rigid") + (forte ? "_forte_" : "_piano_") + law;
        if (name.find(filter) == std::string::npos) continue;
        auto description = bench::steinway45(flexible);
        for (auto& contact : description.contacts) {
          const auto pair = std::get<ExponentialPair>(contact.law);
          if (law == "felt_memory") {
            contact.law = memory(Envelope::from_curves(pair.loading, pair.unloading,
                                                       contact.number == 2 ? 2.6e-3 : 0.0));
          } else if (law == "micromechanical") {
            contact.law = memory(layer_envelope(felts.at(contact.number)));
          } else {
            contact.law = ExponentialPair{pair.loading, pair.unloading, pair.alpha,
                                          ExponentialPair::Form::kPrinted};
          }
        }
        Case c{name, assemble(description), {}};
        for (int i = 0; i < kStrokes; ++i) {
          c.inputs.push_back(forte ? ramp(19.0 + 1.1 * i, 0.05, 0.0930)
                                   : ramp(5.0 + 0.2 * i, 0.02, 0.25));
        }
        out.push_back(std::move(c));
      }
    }
  }
  return out;
}

double processor_time() {
  timespec t{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
  return 1e3 * static_cast<double>(t.tv_sec) + 1e-6 * static_cast<double>(t.tv_nsec);
}

void save(const std::string& path, const Trace& t) {
  std::ofstream out(path, std::ios::binary);
  const auto put = [&](const void* from, std::size_t bytes) {
    out.write(static_cast<const char*>(from), static_cast<std::streamsize>(bytes));
  };
  for (const auto* m : {&t.place, &t.force}) {
    const Eigen::Index size[] = {m->rows(), m->cols()};
    put(size, sizeof size);
    put(m->data(), sizeof(double) * static_cast<std::size_t>(m->size()));
  }
  const double rest[] = {t.impact, t.impact_speed, t.let_off, t.peak};
  put(rest, sizeof rest);
}

bool load(const std::string& path, Trace& t) {
  std::ifstream in(path, std::ios::binary);
  if (!in) return false;
  const auto get = [&](void* to, std::size_t bytes) {
    in.read(static_cast<char*>(to), static_cast<std::streamsize>(bytes));
  };
  for (auto* m : {&t.place, &t.force}) {
    Eigen::Index size[2];
    get(size, sizeof size);
    m->resize(size[0], size[1]);
    get(m->data(), sizeof(double) * static_cast<std::size_t>(m->size()));
  }
  double rest[4];
  get(rest, sizeof rest);
  t.impact = rest[0];
  t.impact_speed = rest[1];
  t.let_off = rest[2];
  t.peak = rest[3];
  return static_cast<bool>(in);
}

}  // namespace

int main(int argc, char** argv) {
  std::string filter, keep;
  std::vector<double> tolerances;
  int repeat = 1;
  for (int i = 1; i < argc; ++i) {
    const std::string option = argv[i];
    if (option == "--help" || i + 1 == argc) {
      std::fprintf(stderr,
                   "usage: work_precision [--case TEXT] [--rtol X]... [--repeat N] [--keep FOLDER "
                   "for the references]\n");
      return option == "--help" ? 0 : 2;
    }
    const char* value = argv[++i];
    if (option == "--case") filter = value;
    if (option == "--keep") keep = value;
    if (option == "--rtol") tolerances.push_back(std::atof(value));
    if (option == "--repeat") repeat = std::max(1, std::atoi(value));
  }
  if (tolerances.empty()) tolerances = {1e-5, 3e-6, 1e-6, 3e-7, 1e-7};
  try {
    std::printf("%-31s %6s %6s %6s %5s %5s %5s %6s", "means of ten strokes", "rtol", "steps", "rhs",
                "jac", "fact", "rej", "ms");
    for (const char* name : kErrorNames) std::printf(" %8s", name);
    std::printf(" | root mean squares\n");
    for (const Case& c : cases(filter)) {
      std::vector<Trace> references;
      for (std::size_t k = 0; k < c.inputs.size(); ++k) {
        const std::string path = keep + "/" + c.name + std::to_string(k);
        references.emplace_back();
        if (!keep.empty() && load(path, references.back())) continue;
        SimulationOptions fine = options(1e-10);
        fine.method = Method::kCvode;
        references.back() = trace_of(*c.mechanism, simulate(c.mechanism, c.inputs[k], fine));
        if (!keep.empty()) save(path, references.back());
      }
      for (const double rtol : tolerances) {
        const auto count = static_cast<double>(c.inputs.size());
        IntegratorCounts counts;
        Errors logs{}, squares{};
        double time = 0.0;
        for (std::size_t k = 0; k < c.inputs.size(); ++k) {
          double best = 1e300;
          RunResult run;
          SimulationOptions bare = options(rtol);
          bare.outputs = false;
          for (int i = 0; i < repeat; ++i) {
            const double begin = processor_time();
            run = simulate(c.mechanism, c.inputs[k], bare);
            best = std::min(best, processor_time() - begin);
          }
          time += best / count;
          counts += run.counts;
          run = simulate(c.mechanism, c.inputs[k], options(rtol));
          const Errors e = compare(trace_of(*c.mechanism, run), references[k]);
          add(e, count, logs, squares);
        }
        const auto mean = [&](long n) { return std::lround(static_cast<double>(n) / count); };
        std::printf("%-31s %6.0e %6ld %6ld %5ld %5ld %5ld %6.2f", c.name.c_str(), rtol,
                    mean(counts.steps), mean(counts.rhs), mean(counts.jacobians),
                    mean(counts.factorizations), mean(counts.rejected), time);
        for (std::size_t i = 0; i < kErrors; ++i) std::printf(" %8.1e", std::exp(logs[i]));
        std::printf(" |");
        for (std::size_t i = 0; i < kErrors; ++i) std::printf(" %7.0e", std::sqrt(squares[i]));
        std::printf("\n");
        std::fflush(stdout);
      }
    }
  } catch (const std::exception& error) {
    std::fprintf(stderr, "work_precision: %s\n", error.what());
    return 1;
  }
  return 0;
}
