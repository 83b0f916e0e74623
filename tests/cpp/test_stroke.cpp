// A stroke of the packaged action: where the work of the finger goes, against sums over the
// outputs.
#include <doctest/doctest.h>

#include <algorithm>
#include <string>

#include "feltmb/model/simulation.hpp"
#include "steinway45.hpp"

namespace {

using namespace feltmb;

Eigen::VectorXd output(const RunResult& run, const std::string& name) {
  const auto found = std::find(run.names.begin(), run.names.end(), name);
  REQUIRE(found != run.names.end());
  return run.data.col(found - run.names.begin());
}

}  // namespace

TEST_CASE("energy of a stroke: work of the finger, heat and what is stored") {
  for (const bool flexible : {false, true}) {
    CAPTURE(flexible);
    SimulationOptions o;
    o.duration = 0.2;
    o.rtol = 1e-7;
    o.output_rate = 40000.0;
    o.peak_contacts = {6};
    const RunResult run =
        simulate(assemble(bench::steinway45(flexible)),
                 {Profile({0.05, 0.1405}, {0.0, 25.0}, Profile::Interpolation::kLinear)}, o);
    REQUIRE(run.status == RunStatus::kDone);
    CHECK(run.code == ErrorCode::kNone);
    CHECK(run.peaks[0].force > 10.0);  // the hammer has struck
    const Eigen::Index last = run.time.size() - 1;
    const Eigen::VectorXd force = output(run, "finger.force");
    const Eigen::VectorXd place = output(run, "finger.displacement");
    double work = 0.0;
    for (Eigen::Index i = 0; i < last; ++i) {
      work += 0.5 * (force[i] + force[i + 1]) * (place[i + 1] - place[i]);
    }
    CHECK(work > 0.05);
    CHECK(run.ledger(last, 0) == doctest::Approx(work).epsilon(1e-5).scale(work));
    double stored = 0.0;
    for (const char* part : {"kinetic", "gravity", "elastic", "contact", "string"}) {
      const Eigen::VectorXd energy = output(run, "energy." + std::string(part));
      stored += energy[last] - energy[0];
    }
    double heat = 0.0;
    for (Eigen::Index column = 2; column < run.ledger.cols(); ++column) {
      heat += run.ledger(last, column);
      // Nothing that is lost comes back.
      const Eigen::VectorXd lost = run.ledger.col(column);
      const double most_back = (lost.head(last) - lost.tail(last)).maxCoeff();
      CAPTURE(run.ledger_names[static_cast<std::size_t>(column)]);
      CHECK(most_back < 1e-6 * work);
    }
    CHECK(heat > 0.1 * work);
    CHECK(work == doctest::Approx(stored + heat).epsilon(2e-5).scale(work));
  }
}
