#include <doctest/doctest.h>
#include <pthread.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <numbers>
#include <stdexcept>
#include <system_error>
#include <thread>
#include <vector>

#include "feltmb/core/error.hpp"
#include "feltmb/numeric/chebyshev.hpp"
#include "feltmb/numeric/elliptic.hpp"
#include "feltmb/numeric/parallel.hpp"
#include "feltmb/numeric/quadrature.hpp"
#include "feltmb/numeric/random.hpp"
#include "feltmb/numeric/roots.hpp"

using namespace feltmb;
using doctest::Approx;

TEST_CASE("Gauss-Legendre rules integrate polynomials of degree 2n - 1") {
  for (std::size_t n : {1, 2, 5, 16, 33}) {
    const QuadratureRule rule = make_gauss_legendre(n);
    for (std::size_t degree = 0; degree < 2 * n; ++degree) {
      const double exact = degree % 2 == 1 ? 0.0 : 2.0 / (static_cast<double>(degree) + 1.0);
      const double got = integrate_rule(
          rule, [&](double x) { return std::pow(x, static_cast<double>(degree)); }, -1.0, 1.0);
      CHECK(std::abs(got - exact) < 1e-13);
    }
  }
  CHECK_THROWS_AS(make_gauss_legendre(0), InvalidParameter);
}

TEST_CASE("adaptive integration resolves a narrow peak") {
  const auto peak = [](double x) { return 1e-3 / (x * x + 1e-6); };
  const IntegralEstimate estimate = integrate_adaptive(peak, -1.0, 1.0, 1e-12);
  CHECK(estimate.value == Approx(2.0 * std::atan(1e3)).epsilon(1e-12));
}

TEST_CASE("Carlson integrals against the complete integrals of the standard library") {
  for (double k : {0.0, 0.1, 0.5, 0.9, 0.999}) {
    const double first = carlson_rf(0.0, 1.0 - k * k, 1.0);
    CHECK(first == Approx(std::comp_ellint_1(k)).epsilon(1e-13));
    const double second = first - k * k / 3.0 * carlson_rd(0.0, 1.0 - k * k, 1.0);
    CHECK(second == Approx(std::comp_ellint_2(k)).epsilon(1e-13));
  }
  // DLMF 19.36: published values.
  CHECK(carlson_rf(1.0, 2.0, 0.0) == Approx(1.3110287771461).epsilon(1e-13));
  CHECK(carlson_rd(0.0, 2.0, 1.0) == Approx(1.7972103521034).epsilon(1e-13));
  CHECK(carlson_rd(2.0, 3.0, 4.0) == Approx(0.16510527294261).epsilon(1e-13));
  CHECK(std::isnan(carlson_rf(-1.0, 1.0, 1.0)));
}

TEST_CASE("cumulative integral is exact and starts at zero") {
  const CumulativeIntegral integral([](double x) { return std::exp(-x) * std::cos(5.0 * x); }, 0.5,
                                    4.0, 12);
  const auto primitive = [](double x) {
    return std::exp(-x) * (5.0 * std::sin(5.0 * x) - std::cos(5.0 * x)) / 26.0;
  };
  CHECK(integral.integral(0.5) == 0.0);
  for (double x : {0.500001, 0.7, 1.3, 2.0, 3.999, 4.0}) {
    CHECK(std::abs(integral.integral(x) - (primitive(x) - primitive(0.5))) < 1e-14);
    CHECK(integral.integrand(x) == Approx(std::exp(-x) * std::cos(5.0 * x)).epsilon(1e-11));
  }
}

TEST_CASE("root finder with and without a usable slope") {
  const auto cubic = [](double x) { return std::pair(x * x * x - 2.0, 3.0 * x * x); };
  CHECK(find_root(cubic, 0.0, 5.0) == Approx(std::cbrt(2.0)).epsilon(1e-15));
  const auto blind = [](double x) { return std::pair(x * x * x - 2.0, std::nan("")); };
  CHECK(find_root(blind, 0.0, 5.0) == Approx(std::cbrt(2.0)).epsilon(1e-14));
  const auto positive = [](double x) { return std::pair(x + 1.0, 1.0); };
  CHECK(find_root(positive, 0.0, 5.0) == 0.0);
}

TEST_CASE("loops are divided completely and errors come back") {
  for (std::size_t threads : {1, 2, 3, 7}) {
    std::vector<int> hits(1000, 0);
    parallel_for(hits.size(), threads, [&](std::size_t begin, std::size_t end) {
      for (std::size_t i = begin; i < end; ++i) ++hits[i];
    });
    ThreadTeam team(threads);
    for (int repeat = 0; repeat < 50; ++repeat) {
      team.run(hits.size(), [&](std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i) ++hits[i];
      });
    }
    CHECK(std::all_of(hits.begin(), hits.end(), [](int h) { return h == 51; }));
    CHECK_THROWS_AS(parallel_for(10, threads,
                                 [](std::size_t, std::size_t) {
                                   throw InvalidParameter("expected by the test");
                                 }),
                    InvalidParameter);
  }
}

/// While it lives every new thread asks for more stack than there are addresses, and is refused.
class NoThreads {
 public:
  NoThreads() {
    pthread_attr_t none;
    pthread_getattr_default_np(&before_);
    pthread_getattr_default_np(&none);
    pthread_attr_setstacksize(&none, std::size_t{1} << 47);
    pthread_setattr_default_np(&none);
    pthread_attr_destroy(&none);
  }
  ~NoThreads() {
    pthread_setattr_default_np(&before_);
    pthread_attr_destroy(&before_);
  }

 private:
  pthread_attr_t before_;
};

TEST_CASE("where the system has no threads the caller does all of the work") {
  const NoThreads none;
  CHECK_THROWS_AS(std::thread([] {}).join(), std::system_error);
  std::vector<int> hits(100, 0);
  const auto hit = [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) ++hits[i];
  };
  parallel_for(hits.size(), 4, hit);
  ThreadTeam team(4);
  CHECK(team.size() == 1);
  team.run(hits.size(), hit);
  CHECK(std::all_of(hits.begin(), hits.end(), [](int h) { return h == 2; }));
  CHECK_THROWS_AS(
      parallel_for(
          10, 4, [](std::size_t, std::size_t) { throw InvalidParameter("expected by the test"); }),
      InvalidParameter);
}

TEST_CASE("threads are no more than a few a core") {
  const std::size_t cores = resolve_threads(0);
  CHECK(resolve_threads(1) == 1);
  CHECK(resolve_threads(100000) == kThreadsPerCore * cores);
}

TEST_CASE("random numbers: reproducible, uniform, normal") {
  Random a(5);
  Random b(5);
  Random c(5, 1);
  CHECK(a.bits() == b.bits());
  CHECK(a.bits() != c.bits());
  double sum = 0.0;
  double square = 0.0;
  constexpr int kCount = 200000;
  for (int i = 0; i < kCount; ++i) {
    const double x = a.normal();
    sum += x;
    square += x * x;
  }
  CHECK(std::abs(sum / kCount) < 5.0 / std::sqrt(kCount));
  CHECK(std::abs(square / kCount - 1.0) < 5.0 * std::sqrt(2.0 / kCount));
}
