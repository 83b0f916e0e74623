// Felt layers against closed forms: columns under cylinder and sphere, flat punch, large radius;
// the unloading shape that never falls; energies of a loop against quadrature.
#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <vector>

#include "feltmb/contact/area.hpp"
#include "feltmb/contact/felt_layer.hpp"
#include "feltmb/core/error.hpp"
#include "quadrature.hpp"
#include "table_a12.hpp"

namespace {

using namespace feltmb;

constexpr double kPi = std::numbers::pi;
constexpr double kThickness = 6e-3;
constexpr double kStiffness = 3e8;  // Pa/m, of the layer

/// Pressure kStiffness h^n strain^n / h^(n-1), unloading along 0.6 of it but for the end.
std::shared_ptr<const Envelope> power_pressure(int n) {
  EnvelopeShape shape;
  shape.closing = 0.5;
  shape.reach = 0.9;
  shape.loading = [n](double s) { return kStiffness * kThickness * std::pow(s, n); };
  shape.ratio = [](double x, double) { return 0.4 + 0.6 * x * x; };
  return Envelope::from_shape(shape);
}

FeltLayer layer(const std::shared_ptr<const Envelope>& pressure, const ContactArea& area,
                LayerCompression compression = LayerCompression::kColumns) {
  return {pressure, kThickness, area, compression};
}

FeltMaterial soft_red() {
  FeltMaterial m;
  m.mu = 0.35;
  m.Wf0 = 0.8;
  m.d_f = 25e-6;
  m.v_f0 = 0.132;
  m.v_f_max = 0.33;
  m.loading = {4.0e6, 1.3};
  m.unloading = {3.82e5, 3.16};
  return m;
}

}  // namespace

TEST_CASE("areas: closed forms, full size, growth") {
  CHECK(shared_area(ConstantArea{2e-4}, 1e-9) == 2e-4);
  CHECK(shared_area(ConstantArea{2e-4}, 0.0) == 0.0);
  const double r = 5e-3;
  const double e = 4e-4;
  CHECK(shared_area(SphereOnLayer{r}, e) == doctest::Approx(kPi * (2 * r * e - e * e)));
  CHECK(shared_area(CircleOnLayer{r, 1e-2}, e) ==
        doctest::Approx(2e-2 * std::sqrt(2 * r * e - e * e)));
  CHECK(shared_area(CircleOnLayer{r, 1e-2, 1e-3}, e) == doctest::Approx(1e-5));
  const ContactArea areas[] = {ConstantArea{1e-4}, CrossedCylinders{9e-3, 5e-4},
                               CircleOnLayer{r, 1e-2}, CircleOnLayer{r, 1e-2, 4e-3},
                               SphereOnLayer{r}};
  for (const auto& area : areas) {
    const FullArea full = full_area(area);
    CHECK(shared_area(area, full.compression + 1e-3) == doctest::Approx(full.size));
    double before = 0.0;
    for (int i = 1; i <= 200; ++i) {
      const double now = shared_area(area, 1.2e-2 * i / 200);
      CHECK(now >= before * (1 - 1e-12));
      before = now;
    }
  }
  CHECK_THROWS_AS(validate(ContactArea{CircleOnLayer{-1.0, 0.0}}), InvalidParameter);
}

TEST_CASE("columns under a linear pressure: volume of the indenter, Hertz-like powers") {
  const auto pressure = power_pressure(1);
  const double r = 5e-3;
  const double b = 8e-3;
  const auto sphere = layer_envelope(layer(pressure, SphereOnLayer{r}));
  const auto cylinder = layer_envelope(layer(pressure, CircleOnLayer{r, b}));
  for (const double e : {1e-5, 1e-4, 5e-4, 1.5e-3, 2.9e-3}) {
    const double cap = kPi * e * e * (3 * r - e) / 3;
    CHECK(sphere->loading(e).force == doctest::Approx(kStiffness * cap).epsilon(1e-6));
    const double segment = r * r * std::acos((r - e) / r) - (r - e) * std::sqrt(2 * r * e - e * e);
    CHECK(cylinder->loading(e).force == doctest::Approx(kStiffness * b * segment).epsilon(1e-6));
  }
  // Small compression: e^2 under a sphere, e^1.5 under a cylinder.
  const double e = 1e-6;
  CHECK(sphere->loading(4 * e).force / sphere->loading(e).force ==
        doctest::Approx(16.0).epsilon(2e-3));
  CHECK(cylinder->loading(4 * e).force / cylinder->loading(e).force ==
        doctest::Approx(8.0).epsilon(2e-3));
  const auto crossed = layer_envelope(layer(pressure, CrossedCylinders{r, 2e-3}));
  CHECK(crossed->loading(2e-5).force ==
        doctest::Approx(kStiffness * kPi * std::sqrt(r * 2e-3) * 4e-10).epsilon(3e-3));
}

TEST_CASE("columns under a cubic pressure and a sphere") {
  const auto sphere = layer_envelope(layer(power_pressure(3), SphereOnLayer{5e-3}));
  const double c = kStiffness * kThickness / std::pow(kThickness, 3);
  for (const double e : {2e-4, 1e-3, 2.5e-3}) {
    const double exact = 2 * kPi * c * (5e-3 * std::pow(e, 4) / 4 - std::pow(e, 5) / 20);
    CHECK(sphere->loading(e).force == doctest::Approx(exact).epsilon(1e-5));
  }
}

TEST_CASE("flat punch: columns are the even layer") {
  const auto pressure = pressure_envelope(soft_red());
  const ContactArea flat = ConstantArea{1e-4};
  const auto even = layer_envelope(layer(pressure, flat, LayerCompression::kEven));
  const auto columns = layer_envelope(layer(pressure, flat));
  for (const double e : {1e-5, 4e-4, 2e-3, 3.5e-3, 4e-3}) {
    CHECK(columns->loading(e).force == even->loading(e).force);
    CHECK(columns->ratio(0.4, e).force == even->ratio(0.4, e).force);
    CHECK(even->loading(e).force ==
          doctest::Approx(1e-4 * pressure->loading(e / kThickness).force).epsilon(1e-6));
  }
}

TEST_CASE("large radius: a felt of some length becomes an even layer") {
  const auto pressure = pressure_envelope(soft_red());
  const auto even =
      layer_envelope(layer(pressure, ConstantArea{5e-3 * 8e-3}, LayerCompression::kEven));
  double before = 1.0;
  for (const double radius : {0.05, 0.5, 5.0}) {
    const auto columns = layer_envelope(layer(pressure, CircleOnLayer{radius, 8e-3, 5e-3}));
    const double e = 2e-3;
    const double load = 1.0 - columns->loading(e).force / even->loading(e).force;
    const double back = 1.0 - columns->loading(e).force * columns->ratio(0.5, e).force /
                                  (even->loading(e).force * even->ratio(0.5, e).force);
    CHECK(load > 0.0);
    CHECK(load < before);
    // The gap at the edge is l^2 / 8 R: ten times the radius, a tenth of the difference.
    if (before < 1.0) CHECK(load == doctest::Approx(0.1 * before).epsilon(0.1));
    CHECK(std::fabs(back) < 0.05);
    before = load;
  }
}

TEST_CASE("each column unloads by its own largest compression") {
  const auto pressure = pressure_envelope(soft_red());
  const double r = 5e-3;
  const auto columns = layer_envelope(layer(pressure, SphereOnLayer{r}));
  for (const double top : {4e-4, 1.5e-3, 3e-3}) {
    for (const double x : {0.2, 0.5, 0.9}) {
      const double e = x * top;
      const double exact = quadrature(
          [&](double g) {
            const double u = (e - g) / kThickness;
            const double u_m = (top - g) / kThickness;
            return pressure->loading(u).force * pressure->ratio(u / u_m, u_m).force * 2 * kPi *
                   (r - g);
          },
          0.0, e, 400);
      const double load = columns->loading(e).force;
      CHECK(std::fabs(load * columns->ratio(x, top).force - exact) <
            1e-3 * columns->loading(top).force);
    }
  }
}

TEST_CASE(
    "separate columns: same branches, and their transition is that of one z to some percent") {
  const FeltLayer under = layer(pressure_envelope(soft_red()), SphereOnLayer{9e-3});
  const auto envelope = layer_envelope(under);
  LayerColumns columns(under, 200, 0.2);
  const ContactLaw law(FeltMemory{envelope, 0.2});
  LawPath path(law);
  const double top = 3e-3;
  double most = 0.0;
  double before = 0.0;
  for (const double end : {top, 0.4 * top, 0.9 * top, 0.1 * top, top, 0.0}) {
    for (int i = 1; i <= 100; ++i) {
      const double e = before + (end - before) * i / 100;
      most = std::max(most, std::fabs(columns.step(e) - path.step(e, 1.0)));
    }
    before = end;
  }
  CHECK(most < 0.02 * envelope->loading(top).force);
  CHECK(most > 0.0);
}

TEST_CASE("tables are made once") {
  const auto a = pressure_envelope(soft_red());
  CHECK(pressure_envelope(soft_red()) == a);
  CHECK(layer_envelope(layer(a, SphereOnLayer{7e-3})) ==
        layer_envelope(layer(a, SphereOnLayer{7e-3})));
  CHECK(layer_envelope(layer(a, SphereOnLayer{7e-3})) !=
        layer_envelope(layer(a, SphereOnLayer{7.1e-3})));
}

TEST_CASE("unloading shapes of Table A.12 never fall, and keep the work of the loop") {
  int repaired = 0;
  for (const auto& row : table_a12::kRows) {
    const auto envelope =
        Envelope::from_curves(row.loading, row.unloading, row.contact == 2 ? 2.6e-3 : 0.0);
    double before = 0.0;
    for (int i = 0; i <= 2000; ++i) {
      const CurveValue rho = envelope->ratio(i / 2000.0, 1e-3);
      CHECK(rho.force >= before - 1e-14);
      CHECK(rho.slope >= 0.0);
      before = rho.force;
    }
    const double end = envelope->closing();
    const double top = envelope->loading(end).force;
    CHECK(envelope->repair().force < 0.012 * top);
    repaired += envelope->repair().force > 0.0 ? 1 : 0;
    if (row.contact == 2) continue;  // raised to close
    const double area = quadrature(
        [&](double e) {
          const double load = envelope->loading(e).force;
          return load - std::clamp(evaluate(row.unloading, e).force, 0.0, load);
        },
        0.0, end, 400);
    CHECK(envelope->loop_area(end).force == doctest::Approx(area).epsilon(2e-3));
  }
  CHECK(repaired >= 13);
}

TEST_CASE("energies of a loop are those of its forces") {
  const auto& row = table_a12::kRows[0];
  const std::shared_ptr<const Envelope> envelopes[] = {
      Envelope::from_curves(row.loading, row.unloading),
      layer_envelope(layer(pressure_envelope(soft_red()), SphereOnLayer{9e-3}))};
  for (const auto& envelope : envelopes) {
    for (const double share : {0.2, 0.7, 1.0, 1.15}) {
      const double top = share * envelope->closing();
      const double whole = envelope->loading_energy(top);
      for (const double x : {0.1, 0.5, 0.95, 1.0}) {
        const auto load = [&](double e) { return envelope->loading(e).force; };
        const auto back = [&](double e) {
          return envelope->loading(e).force * envelope->ratio(e / top, top).force;
        };
        CHECK(std::fabs(envelope->loading_energy(x * top) - quadrature(load, 0.0, x * top, 500)) <
              1e-7 * whole);
        CHECK(std::fabs(envelope->unloading_energy(x * top, top) -
                        quadrature(back, 0.0, x * top, 500)) < 3e-5 * whole);
      }
    }
  }
}
