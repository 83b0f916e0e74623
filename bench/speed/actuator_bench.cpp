// Problem A: hub-beam actuator of thesis chapter 5, undamped, on its felt stop. No Python.
// Prints time, work counts and errors against reference/ref_A_*.csv. See README.md beside this
// file.

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <limits>
#include <sstream>
#include <string>
#include <vector>

#include "feltmb/model/actuator.hpp"

namespace {

using feltmb::Profile;

struct Reference {
  std::vector<double> tip, force, angle;
};

Reference read(const std::string& path) {
  std::ifstream file(path);
  if (!file) {
    std::fprintf(stderr, "actuator_bench: cannot read %s\n", path.c_str());
    std::exit(1);
  }
  Reference out;
  std::string line;
  std::getline(file, line);
  while (std::getline(file, line)) {
    std::replace(line.begin(), line.end(), ',', ' ');
    std::istringstream cells(line);
    double t = 0.0, tip = 0.0, force = 0.0, angle = 0.0;
    cells >> t >> tip >> force >> angle;
    out.tip.push_back(tip);
    out.force.push_back(force);
    out.angle.push_back(angle);
  }
  return out;
}

feltmb::Actuator actuator(bool wood) {
  feltmb::ActuatorDescription d;
  d.arm.hub_inertia = 51.35e-6;
  d.arm.hub_radius = wood ? 68.48e-3 : 61.08e-3;
  d.arm.sections = {wood ? feltmb::ArmSection{33.05e-3, 774.0, 22.39e-6, 10e9, 5.93e-12}
                         : feltmb::ArmSection{38.85e-3, 2540.0, 81.44e-6, 6.83e10, 283.25e-12}};
  d.arm.tip_mass = wood ? 1.29e-3 : 1.57e-3;
  d.arm.elements = 10;
  d.gravity = -9.81;
  d.linear_gravity = true;
  d.gap = 10.5e-3;
  d.stop = feltmb::ExponentialPair{
      {2630.0, 1360.0, 800.0}, {7.8, 360.0, 210.0}, 10.0, feltmb::ExponentialPair::Form::kPrinted};
  return feltmb::Actuator(d);
}

double largest(const Eigen::MatrixXd& a, const std::vector<double>& b) {
  double worst = 0.0;
  for (std::size_t i = 0; i < b.size(); ++i) {
    worst = std::max(worst, std::fabs(a(static_cast<Eigen::Index>(i)) - b[i]));
  }
  return worst;
}

}  // namespace

int main(int argc, char** argv) {
  const int repeat = argc > 1 ? std::max(1, std::atoi(argv[1])) : 11;
  const Profile torque({0.0, 0.06}, {0.0, 3.0}, Profile::Interpolation::kLinear);
  std::printf("problem A, 10 elements, 0.2 s, 2001 outputs with ledger; best of %d, one thread\n",
              repeat);
  std::printf("%-9s %9s %8s %7s %8s %8s %10s %10s %10s\n", "arm", "tolerance", "ms", "steps",
              "rejected", "forces", "err F/peak", "err tip m", "err rad");
  for (const bool wood : {true, false}) {
    const std::string name = wood ? "wood" : "aluminum";
    const Reference reference =
        read(std::string(FELTMB_BENCH_REFERENCE) + "/ref_A_" + name + ".csv");
    const double peak = *std::max_element(reference.force.begin(), reference.force.end());
    const feltmb::Actuator made = actuator(wood);
    for (const double tolerance : {1e-3, 3e-4, 1e-4, 3e-5, 1e-5, 1e-6}) {
      feltmb::ActuatorRun run;
      double best = std::numeric_limits<double>::infinity();
      for (int i = 0; i < repeat; ++i) {
        run = feltmb::simulate(made, torque, {0.2, 10000.0, tolerance});
        best = std::min(best, run.wall);
      }
      const auto column = [&](const char* wanted) {
        const auto at = std::find(run.names.begin(), run.names.end(), wanted) - run.names.begin();
        return Eigen::MatrixXd(run.data.col(at));
      };
      std::printf("%-9s %9.0e %8.2f %7ld %8ld %8ld %10.1e %10.1e %10.1e\n", name.c_str(), tolerance,
                  1e3 * best, run.counts.steps, run.counts.rejected, run.counts.forces,
                  largest(column("stop.force"), reference.force) / peak,
                  largest(column("tip.travel"), reference.tip),
                  largest(column("hub.angle"), reference.angle));
    }
  }
  return 0;
}
