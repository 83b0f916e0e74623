#include <doctest/doctest.h>

#include <cmath>
#include <limits>
#include <string>
#include <vector>

#include "feltmb/core/error.hpp"
#include "feltmb/fiber/bead_spring.hpp"

using namespace feltmb;

namespace {

BeadSpringParams small_box() {
  BeadSpringParams p;
  p.n_fibers = 30;
  p.n_beads = 11;
  p.v_f = 0.05;
  p.crimp = 0.2;
  p.friction = 0.3;
  p.seed = 2;
  p.drag = 0.05;
  return p;
}

}  // namespace

TEST_CASE("bead-spring results do not depend on the threads or on a restart") {
  BeadSpringNetwork one(small_box(), 1);
  BeadSpringNetwork three(small_box(), 3);
  one.relax(200);
  three.relax(200);
  one.advance(300, 1e-4);
  three.advance(150, 1e-4);
  BeadSpringNetwork resumed(small_box(), three.state(), 2);
  resumed.advance(150, 1e-4);
  CHECK(one.state().positions == resumed.state().positions);
  CHECK(one.state().contact_springs == resumed.state().contact_springs);
  CHECK(one.sample().pressure == resumed.sample().pressure);
  CHECK(one.sample().work == resumed.sample().work);
}

TEST_CASE("damaged states are refused, all faults at once") {
  BeadSpringNetwork network(small_box(), 1);
  network.relax(100);
  network.advance(100, 1e-4);
  BeadSpringState state = network.state();
  REQUIRE(!state.contact_pairs.empty());
  state.positions[7] = std::numeric_limits<double>::quiet_NaN();
  state.contact_pairs[1] = 1'000'000;
  state.books[0] = -5.0;
  state.box.pop_back();
  try {
    BeadSpringNetwork(small_box(), state, 1);
    FAIL("no exception");
  } catch (const InvalidParameter& error) {
    const std::string text = error.what();
    for (const char* word :
         {"positions holds", "contact_pairs has the pair", "step -5", "box has"}) {
      CHECK(text.find(word) != std::string::npos);
    }
  }
}

TEST_CASE("straining changes the box as asked") {
  BeadSpringNetwork network(small_box(), 1);
  network.relax(100);
  network.advance(100, 2e-4);
  CHECK(network.sample().strain == doctest::Approx(0.02).epsilon(1e-12));
  CHECK_THROWS_AS(network.advance(1, 0.5), InvalidParameter);
}

TEST_CASE("faults of the parameters are named together") {
  BeadSpringParams p = small_box();
  p.n_fibers = 1;
  p.segment_length = 1e-6;
  p.drag = 0.0;
  try {
    validate(p);
    FAIL("no exception");
  } catch (const InvalidParameter& error) {
    const std::string text = error.what();
    for (const char* word : {"n_fibers", "segment_length", "drag"}) {
      CHECK(text.find(word) != std::string::npos);
    }
  }
}
