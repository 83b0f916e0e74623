// Finger input against time: interpolation, slopes, breakpoints, faults.
#include <doctest/doctest.h>

#include <cmath>
#include <initializer_list>
#include <string>
#include <vector>

#include "feltmb/core/error.hpp"
#include "feltmb/model/profile.hpp"

using feltmb::Profile;

namespace {

constexpr auto kLinear = Profile::Interpolation::kLinear;
constexpr auto kMonotone = Profile::Interpolation::kMonotone;
constexpr auto kSpline = Profile::Interpolation::kSpline;

std::string message_of(const std::vector<double>& time, const std::vector<double>& value) {
  try {
    const Profile profile(time, value, kLinear);
  } catch (const feltmb::InvalidParameter& error) {
    return error.what();
  }
  return "";
}

}  // namespace

TEST_CASE("linear profile: straight between knots, constant outside") {
  const Profile p({0.1, 0.3, 0.4}, {0.0, 5.0, 1.0}, kLinear);
  CHECK(p.value(-1.0) == 0.0);
  CHECK(p.value(0.1) == 0.0);
  CHECK(p.value(0.2) == doctest::Approx(2.5));
  CHECK(p.value(0.3) == doctest::Approx(5.0));
  CHECK(p.value(0.35) == doctest::Approx(3.0));
  CHECK(p.value(9.0) == 1.0);
  CHECK(p.rate(0.2) == doctest::Approx(25.0));
  CHECK(p.rate(0.35) == doctest::Approx(-40.0));
  CHECK(p.rate(0.05) == 0.0);
  CHECK(p.rate(0.5) == 0.0);
}

TEST_CASE("linear profile stops the integrator at its corners only") {
  const Profile p({0.1, 0.2, 0.3, 0.4, 0.5}, {0.0, 1.0, 2.0, 2.0, 2.0}, kLinear);
  CHECK(p.breakpoints() == std::vector<double>{0.1, 0.3});
  CHECK(Profile({0.0, 1.0}, {3.0, 3.0}, kLinear).breakpoints().empty());
}

TEST_CASE("monotone profile meets its knots without overshoot and with a continuous slope") {
  const std::vector<double> time{0.0, 0.1, 0.15, 0.4, 0.41, 0.6};
  const std::vector<double> value{0.0, 2.0, 2.0, 7.0, 7.5, 1.0};
  const Profile p(time, value, kMonotone);
  for (std::size_t i = 0; i < time.size(); ++i) {
    CHECK(p.value(time[i]) == doctest::Approx(value[i]).epsilon(1e-14));
    CHECK(p.rate(time[i] - 1e-10) == doctest::Approx(p.rate(time[i] + 1e-10)).epsilon(1e-4));
  }
  for (std::size_t i = 0; i + 1 < time.size(); ++i) {
    const double low = std::fmin(value[i], value[i + 1]);
    const double high = std::fmax(value[i], value[i + 1]);
    for (int j = 0; j <= 100; ++j) {
      const double v = p.value(time[i] + (time[i + 1] - time[i]) * j / 100.0);
      CHECK(v >= low - 1e-14);
      CHECK(v <= high + 1e-14);
    }
  }
}

TEST_CASE("monotone profile has no corners, but every knot is a stop") {
  const std::vector<double> time{0.0, 1.0, 1.0125, 1.025};
  const Profile p(time, {0.0, 0.0, 16.0, 0.0}, kMonotone);
  CHECK(p.breakpoints().empty());
  CHECK(p.knots() == time);
}

TEST_CASE("spline is the only cubic spline at rest at its ends") {
  // A cubic with zero slope at both ends is its own spline, on any knots.
  const auto cubic = [](double t) { return t * t * (3.0 - 2.0 * t); };
  const std::vector<double> time{0.0, 0.1, 0.25, 0.5, 0.55, 0.9, 1.0};
  std::vector<double> value;
  for (const double t : time) value.push_back(cubic(t));
  const Profile p(time, value, kSpline);
  for (int i = 0; i <= 100; ++i) {
    const double t = 0.01 * i;
    CHECK(p.value(t) == doctest::Approx(cubic(t)).epsilon(1e-12));
    CHECK(p.rate(t) == doctest::Approx(6.0 * t * (1.0 - t)).epsilon(1e-11).scale(1.0));
    if (i < 100) {
      CHECK(p.acceleration(t) == doctest::Approx(6.0 - 12.0 * t).epsilon(1e-10).scale(1.0));
    }
  }
  CHECK(p.smooth());
  CHECK_FALSE(Profile({0.0, 1.0}, {0.0, 1.0}, kLinear).smooth());
}

TEST_CASE("spline is continuous in curvature and stops the integrator at its ends only") {
  const std::vector<double> time{0.0, 0.1, 0.15, 0.4, 0.41, 0.6};
  const Profile p(time, {0.0, 2.0, 2.0, 7.0, 7.5, 1.0}, kSpline);
  for (std::size_t i = 1; i + 1 < time.size(); ++i) {
    CHECK(p.acceleration(time[i] - 1e-9) ==
          doctest::Approx(p.acceleration(time[i] + 1e-9)).epsilon(1e-5));
  }
  CHECK(p.breakpoints() == std::vector<double>{0.0, 0.6});
  CHECK(p.rate(1e-9) == doctest::Approx(0.0).scale(1.0).epsilon(1e-5));
  CHECK(p.acceleration(-0.1) == 0.0);
  CHECK(p.acceleration(0.7) == 0.0);
}

TEST_CASE("acceleration is the difference quotient of the rate, with oscillation too") {
  for (const auto kind : {kMonotone, kSpline}) {
    const Profile p({0.05, 0.2, 0.3, 0.5}, {0.0, 4.0, 5.0, 2.0}, kind, 0.1, 40.0);
    for (const double t : {0.01, 0.07, 0.13, 0.22, 0.29, 0.42, 0.7}) {
      const double h = 1e-6;
      const double slope = (p.rate(t + h) - p.rate(t - h)) / (2.0 * h);
      CHECK(p.acceleration(t) == doctest::Approx(slope).epsilon(1e-6).scale(1e4));
    }
  }
}

TEST_CASE("rate is the difference quotient of the value, with oscillation too") {
  for (const auto kind : {kLinear, kMonotone, kSpline}) {
    const Profile p({0.05, 0.2, 0.3, 0.5}, {0.0, 4.0, 5.0, 2.0}, kind, 0.1, 40.0);
    for (const double t : {0.01, 0.07, 0.13, 0.22, 0.29, 0.42, 0.7}) {
      const double h = 1e-6;
      const double slope = (p.value(t + h) - p.value(t - h)) / (2.0 * h);
      CHECK(p.rate(t) == doctest::Approx(slope).epsilon(1e-6).scale(100.0));
    }
  }
}

TEST_CASE("oscillation is a factor 1 + a sin(2 pi f t)") {
  const Profile p({0.0, 1.0}, {10.0, 10.0}, kLinear, 0.1, 40.0);
  CHECK(p.value(0.5 + 0.25 / 40.0) == doctest::Approx(11.0).epsilon(1e-12));
}

TEST_CASE("faults of a profile are named by their knot") {
  CHECK(message_of({}, {}).find("0 times and 0 values") != std::string::npos);
  CHECK(message_of({0.0, 1.0}, {1.0}).find("2 times and 1 values") != std::string::npos);
  CHECK(message_of({0.0, 1.0, 1.0}, {0.0, 0.0, 0.0}).find("knot 2 does not follow") !=
        std::string::npos);
  CHECK(message_of({0.0, NAN}, {0.0, 0.0}).find("knot 1 is not a finite number") !=
        std::string::npos);
  CHECK(message_of({0.0, 1.0}, {0.0, INFINITY}).find("knot 1") != std::string::npos);
}
