#include <doctest/doctest.h>

#include <cmath>
#include <map>
#include <numbers>
#include <string>

#include "feltmb/core/error.hpp"
#include "feltmb/fiber/compression.hpp"
#include "feltmb/fiber/contact_count.hpp"
#include "feltmb/fiber/history.hpp"
#include "feltmb/fiber/orientation.hpp"
#include "feltmb/numeric/quadrature.hpp"

using namespace feltmb;
using doctest::Approx;

namespace {

const std::map<std::string, std::map<std::string, double>> kExamples = {
    {"van_wyk", {{"k_p", 0.01}, {"E", 2.5e9}, {"v_f0", 0.1}}},
    {"neckar", {{"k_p", 0.01}, {"E", 2.5e9}, {"v_f0", 0.1}, {"v_fm", 0.7}}},
    {"stamm", {{"k_p", 0.01}, {"E", 2.5e9}, {"v_f0", 0.1}, {"v_fm", 0.7}, {"w_f", 0.5}}},
    {"toll_planar", {{"E", 2.5e9}, {"v_f0", 0.1}}},
    {"narter", {{"E", 2.5e9}, {"v_f0", 0.1}, {"gamma", 1.3}}},
    {"alkhagen_toll",
     {{"E", 2.5e9}, {"v_f0", 0.1}, {"k_b", 1.0}, {"k_t", 1.0}, {"beta", 5.0}, {"v_random", 0.07}}},
    {"binomial", {{"K_p", 4e6}, {"gamma", 1.3}, {"v_f0", 0.1}}},
    {"bending_chain", {{"E", 2.5e9}, {"gamma", 1.3}, {"v_f0", 0.1}, {"v_random", 0.1}}},
    {"komori_itoh", {{"E", 2.5e9}, {"v_f0", 0.1}}},
    {"komori_itoh_renewed", {{"E", 2.5e9}, {"v_f0", 0.1}}},
    {"lee_carnaby", {{"E", 2.5e9}, {"v_f0", 0.1}, {"chord_ratio", 0.9}}}};

}  // namespace

TEST_CASE("every law: zero below v0, slope and energy belong to the pressure") {
  CHECK(kExamples.size() == law_descriptions().size());
  for (const auto& [name, parameters] : kExamples) {
    CAPTURE(name);
    const auto law = make_law(name, parameters);
    CHECK(law->pressure(0.1) == 0.0);
    CHECK(law->pressure(0.01) == 0.0);
    CHECK(law->energy(0.1) == 0.0);
    for (double v : {0.1001, 0.12, 0.25, 0.5}) {
      CAPTURE(v);
      if (v > 0.101) {
        const double h = 1e-4 * v;
        const double slope = (law->pressure(v - 2.0 * h) - 8.0 * law->pressure(v - h) +
                              8.0 * law->pressure(v + h) - law->pressure(v + 2.0 * h)) /
                             (12.0 * h);
        CHECK(law->slope(v) == Approx(slope).epsilon(1e-7));
      }
      const double energy =
          integrate_adaptive([&](double x) { return law->pressure(x) / (x * x); }, 0.1, v, 1e-11)
              .value;
      CHECK(std::abs(law->energy(v) - energy) < 1e-8 * energy + 1e-13 * law->pressure(0.5) / 0.1);
    }
  }
}

TEST_CASE("all faults of a parameter set are named at once") {
  try {
    make_law("van_wyk", {{"k_p", -1.0}, {"E", 0.0}, {"x", 1.0}});
    FAIL("no exception");
  } catch (const InvalidParameter& error) {
    const std::string text = error.what();
    for (const char* word : {"k_p = -1", "E = 0 Pa", "\"x\"", "v_f0"}) {
      CHECK(text.find(word) != std::string::npos);
    }
  }
  CHECK_THROWS_AS(make_law("wyk", {}), InvalidParameter);
}

TEST_CASE("the table of the structure agrees with the quadrature") {
  for (double x = std::log(1e-2); x <= std::log(1e4); x += 0.731) {
    const double ratio = std::exp(x);
    const UniaxialStructure exact = compute_uniaxial_structure(ratio);
    const UniaxialStructure table = uniaxial_structure(ratio);
    CHECK(table.f == Approx(exact.f).epsilon(1e-10));
    CHECK(table.n3 == Approx(exact.n3).epsilon(1e-10));
    CHECK(table.e3 == Approx(exact.e3).epsilon(1e-10));
    CHECK(table.sine == Approx(exact.sine).epsilon(1e-10));
    CHECK(table.cos4 == exact.cos4);
  }
}

TEST_CASE("Pan's closed form for isotropic fibers, eq. 3.10") {
  ContactInput input{};
  input.v_f = 0.2;
  input.d_f = 1.0;
  CHECK(mean_free_length(ContactModel::pan, input) ==
        Approx((2.0 + std::numbers::pi * 0.2) / 0.8).epsilon(1e-14));
}

TEST_CASE("a history law starts again after reset") {
  std::shared_ptr<const CompressionLaw> spring = make_law("van_wyk", kExamples.at("van_wyk"));
  const auto law = make_history_law("dunlop", {{"f_c", {10.0, 100.0}}, {"phi", {0.2}}}, spring);
  const double first = law->step(0.0, 0.3, 0.0);
  law->step(1.0, 0.1, 0.0);
  CHECK(law->step(1.0, 0.2, 0.0) != first);
  law->reset();
  CHECK(law->step(0.0, 0.3, 0.0) == first);
}
