// Every law of the list: exact slopes, energies that add up; the later laws against closed forms
// and against the histories of thesis section 2.2; the formulas of the law "expression".
#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <random>
#include <set>
#include <string>
#include <vector>

#include "feltmb/contact/law.hpp"
#include "feltmb/contact/laws/catalog.hpp"
#include "feltmb/contact/path.hpp"
#include "feltmb/core/error.hpp"
#include "feltmb/fiber/history.hpp"

namespace {

using namespace feltmb;

void spring_of(double e, double rate, const double* p, double* out) {
  const double elastic = p[0] * std::pow(e, p[1]);
  out[0] = elastic * (1.0 + p[2] * rate);
  out[1] = p[1] * elastic / e * (1.0 + p[2] * rate);
  out[2] = elastic * p[2];
}

const ExponentialCurve kUp{5.52e3, 1.58e3, -0.60e3};
const ExponentialCurve kDown{0.19e3, 5.04e3, 3.04e3};

std::vector<LawParameters> samples() {
  FeltMemory felt;
  felt.envelope = Envelope::from_curves(kUp, kDown);
  FeltMemory creeping = felt;
  creeping.creep_stiffness = 2e5;
  creeping.creep_damping = 300.0;
  creeping.rate_amplitude = 0.2;
  creeping.rate_time = 1e-3;
  FeltMemory wiping = felt;
  wiping.kappa = 0.05;
  wiping.wiping_out = 0.3;
  FeltReturnPoint returning;
  returning.envelope = felt.envelope;
  ExponentialPair pair{kUp, kDown};
  ExponentialPair relaxing = pair;
  relaxing.rate_amplitude = 0.3;
  relaxing.rate_time = 2e-3;
  return {pair,
          relaxing,
          MeanCurve{kUp, kDown},
          HuntCrossley{4e6, 1.8, 0.6},
          LankaraniNikravesh{4e6, 1.5, 0.7, 1.2},
          KelvinVoigt{8e3, 3.0},
          Stulov{4e8, 2.5, 0.3, 2e-4},
          StulovDifferential{4e8, 2.5, 1e-4},
          Maxwell{1e8, 2.2, 2e8, 2.6, 1e-3},
          Dunlop{2e5, 1.3, 0.2, 0.1, 0.3, 0.8, 50.0},
          felt,
          wiping,
          creeping,
          returning,
          Expression{"k*e^p*(1 + d*rate)", {{"k", 4e6}, {"p", 1.8}, {"d", 0.6}}, {}},
          Callback{&spring_of, {4e6, 1.8, 0.6}}};
}

/// A point of a law: compression, rate, states, largest compression.
struct At {
  double e, rate, largest;
  double s[kMaxLawStates];
  LawMemory memory() const { return {s, largest}; }
};

At random_point(const ContactLaw& law, std::mt19937& random) {
  std::uniform_real_distribution<double> share(0.02, 1.0);
  std::uniform_real_distribution<double> speed(-2.0, 2.0);
  At at{};
  at.e = 9e-4 * share(random);
  at.rate = speed(random);
  at.largest = at.e * (1.0 + 0.5 * share(random));
  if (at.rate > 1.0) at.largest = at.e * share(random);  // on virgin loading
  law.relax(at.e * share(random), at.s);
  for (std::size_t i = 0; i < law.n_states(); ++i) at.s[i] *= share(random);
  if (law.has_memory()) at.s[0] = share(random);  // z
  return at;
}

std::string fault_of(const std::string& text, const std::map<std::string, double>& parameters) {
  try {
    const Formula formula(text, parameters);
  } catch (const InvalidParameter& error) {
    return error.what();
  }
  return "";
}

}  // namespace

TEST_CASE("there is a sample of every law, and every name is there once") {
  std::set<std::size_t> kinds;
  for (const LawParameters& law : samples()) kinds.insert(law.index());
  CHECK(kinds.size() == std::variant_size_v<LawParameters>);
  std::set<std::string> names;
  for (const LawInfo& law : contact_laws()) {
    CHECK(names.insert(law.name).second);
    CHECK(!law.about.empty());
    std::set<std::string> fields;
    for (const FieldInfo& field : law.fields) {
      CHECK(fields.insert(field.name).second);
      CHECK(!field.meaning.empty());
    }
  }
}

TEST_CASE("a law made of its name and the values of its fields is the same law") {
  for (const LawParameters& given : samples()) {
    const ContactLaw law(given);
    const ContactLaw again(make_contact_law(law.name(), values_of(given)));
    CHECK(again.name() == law.name());
    std::mt19937 random(3);
    const At at = random_point(law, random);
    CHECK(again.evaluate(at.e, at.rate, at.memory()).force ==
          law.evaluate(at.e, at.rate, at.memory()).force);
  }
  CHECK_THROWS_WITH_AS(make_contact_law("stulof", {}), doctest::Contains("\"stulof\" is unknown"),
                       InvalidParameter);
  CHECK_THROWS_WITH_AS(make_contact_law("stulov", {{"tim", 1.0}}),
                       doctest::Contains("unknown field tim"), InvalidParameter);
  CHECK_THROWS_WITH_AS(make_contact_law("mean", {{"loading", 1.0}}),
                       doctest::Contains("expected a curve"), InvalidParameter);
}

TEST_CASE("slopes and rates of the states of every law are difference quotients") {
  std::mt19937 random(11);
  for (const LawParameters& given : samples()) {
    const ContactLaw law(given);
    CAPTURE(law.name());
    int looked_at = 0;
    for (int trial = 0; trial < 300; ++trial) {
      const At at = random_point(law, random);
      const std::size_t n = law.n_states();
      // What is one smooth piece around the point is compared.
      std::vector<double*> all;
      At moved = at;
      all.push_back(&moved.e);
      all.push_back(&moved.rate);
      for (std::size_t i = 0; i < n; ++i) all.push_back(&moved.s[i]);
      const int piece = law.piece(at.e, at.rate, at.memory());
      LawStates exact;
      const LawValue value = law.evaluate(at.e, at.rate, at.memory(), &exact);
      bool smooth = true;
      std::vector<LawValue> f(2 * all.size());
      std::vector<LawStates> s(2 * all.size());
      std::vector<double> step(all.size());
      for (std::size_t k = 0; k < all.size(); ++k) {
        const double size = k == 1 ? 1.0 : std::max(std::fabs(*all[k]), 1e-9);
        step[k] = 2e-6 * size;
        for (const int way : {0, 1}) {
          moved = at;
          *all[k] += (way == 0 ? -1.0 : 1.0) * step[k];
          smooth = smooth && law.piece(moved.e, moved.rate, moved.memory()) == piece;
          f[2 * k + way] = law.evaluate(moved.e, moved.rate, moved.memory(), &s[2 * k + way]);
        }
      }
      if (!smooth) continue;
      ++looked_at;
      for (std::size_t k = 0; k < all.size(); ++k) {
        const auto close = [&](double exactly, double low, double high) {
          const double quotient = (high - low) / (2.0 * step[k]);
          const double room = 1e-9 * (std::fabs(low) + std::fabs(high)) / step[k];
          return std::fabs(quotient - exactly) <= 2e-4 * std::fabs(exactly) + room;
        };
        const double by = k == 0 ? value.d_compression : k == 1 ? value.d_rate : exact.force[k - 2];
        CHECK(close(by, f[2 * k].force, f[2 * k + 1].force));
        for (std::size_t i = 0; i < n; ++i) {
          const double rate_by = k == 0   ? exact.rate_by_compression[i]
                                 : k == 1 ? exact.rate_by_rate[i]
                                          : exact.rate_by_state[i][k - 2];
          CHECK(close(rate_by, s[2 * k].rate[i], s[2 * k + 1].rate[i]));
        }
      }
    }
    CHECK(looked_at > 50);
  }
}

TEST_CASE("power in = change of the stored energy + heat, for every law") {
  std::mt19937 random(5);
  for (const LawParameters& given : samples()) {
    const ContactLaw law(given);
    CAPTURE(law.name());
    int looked_at = 0;
    for (int trial = 0; trial < 200; ++trial) {
      const At at = random_point(law, random);
      LawStates states;
      const LawValue value = law.evaluate(at.e, at.rate, at.memory(), &states);
      const double heat = law.dissipated_power(at.e, at.rate, at.memory());
      const auto energy = [&](double t) {
        At moved = at;
        moved.e += t * at.rate;
        for (std::size_t i = 0; i < law.n_states(); ++i) moved.s[i] += t * states.rate[i];
        return law.stored_energy(moved.e, moved.memory());
      };
      const double t = 1e-5 * at.e / std::max(0.05, std::fabs(at.rate));
      const double change = (energy(t) - energy(-t)) / (2.0 * t);
      const double power = value.force * at.rate;
      // The second law of Stulov and rate terms make no claim of an energy of their states.
      const double size = std::fabs(power) + std::fabs(heat) + std::fabs(change) + 1e-6;
      if (law.name() == "felt_memory" && law.n_states() > 1) continue;
      CHECK(std::fabs(power - change - heat) <= 2e-3 * size);
      ++looked_at;
      const bool passive = law.n_states() == 0 || law.name() == "maxwell" ||
                           law.name() == "dunlop" || law.name() == "felt_memory";
      if (passive) CHECK(heat >= -1e-9 * size);
    }
    CHECK((looked_at > 50 || law.n_states() > 1));
  }
}

TEST_CASE("rest: the states keep still, and the force is that of the relaxed law") {
  for (const LawParameters& given : samples()) {
    const ContactLaw law(given);
    CAPTURE(law.name());
    for (const double e : {1e-5, 2e-4, 8e-4}) {
      At at{};
      at.e = e;
      law.relax(e, at.s);
      at.largest = law.felt_compression(e, at.memory());
      LawStates states;
      const double force = law.evaluate(e, 0.0, at.memory(), &states).force;
      CHECK(law.static_force(e).force == doctest::Approx(force).epsilon(1e-9));
      const double h = 1e-4 * e;
      const double slope =
          (law.static_force(e + h).force - law.static_force(e - h).force) / (2.0 * h);
      CHECK(law.static_force(e).slope == doctest::Approx(slope).epsilon(1e-4));
      for (std::size_t i = 0; i < law.n_states(); ++i) {
        const double scale = law.state(i, e).scale;
        CHECK(std::fabs(states.rate[i]) <= 1e-6 * scale / 1e-5);
      }
    }
  }
}

namespace {

/// P = k (1 - v0/v): linear in the strain.
class Linear final : public CompressionLaw {
 public:
  Linear(double k, double v0) : CompressionLaw(v0, 1.0), k_(k) {}

 protected:
  double pressure_at(double v) const override { return k_ * (1.0 - v0_ / v); }
  double slope_at(double v) const override { return k_ * v0_ / (v * v); }
  double energy_at(double) const override { return 0.0; }

 private:
  double k_;
};

/// In, halfway back, in deeper, out.
std::vector<double> way(double deepest, int points) {
  std::vector<double> out{0.0};
  for (const double stop : {0.7, 0.3, 1.0, 0.5, 0.0}) {
    const double from = out.back();
    for (int i = 1; i <= points; ++i) {
      out.push_back(from + (stop * deepest - from) * i / points);
    }
  }
  return out;
}

void compare(const LawParameters& contact, HistoryLaw& history, double step, double error,
             int points = 200) {
  const ContactLaw law(contact);
  LawPath path(law);
  const std::vector<double> e = way(8e-4, points);
  double largest = 0.0;
  double off = 0.0;
  history.reset();
  history.step(0.0, 0.0, 0.0);
  for (std::size_t i = 1; i < e.size(); ++i) {
    const double rate = (e[i] - e[i - 1]) / step;
    const double expected = history.step(step, e[i], rate);
    off = std::max(off, std::fabs(path.step(e[i], step) - expected));
    largest = std::max(largest, expected);
  }
  CHECK(largest > 0.1);
  CHECK(off <= error * largest);
}

}  // namespace

TEST_CASE("the laws of thesis section 2.2 are the histories of the same names") {
  const auto make = [](const char* name, const std::map<std::string, std::vector<double>>& p) {
    return make_history_law(name, p);
  };
  compare(LankaraniNikravesh{4e6, 1.5, 0.7, 1.2},
          *make("lankarani_nikravesh", {{"stiffness", {4e6}},
                                        {"exponent", {1.5}},
                                        {"restitution", {0.7}},
                                        {"impact_speed", {1.2}}}),
          1e-6, 1e-12);
  compare(
      StulovDifferential{4e8, 2.5, 1e-5},
      *make("stulov_differential", {{"stiffness", {4e8}}, {"exponent", {2.5}}, {"time", {1e-5}}}),
      1e-6, 1e-12);
  compare(
      Stulov{4e8, 2.5, 0.3, 2e-4},
      *make("stulov",
            {{"stiffness", {4e8}}, {"exponent", {2.5}}, {"amplitude", {0.3}}, {"time", {2e-4}}}),
      1e-6, 1e-12);
  compare(Maxwell{1e8, 2.2, 2e8, 2.6, 1e-3},
          *make("maxwell",
                {{"E_inf", {1e8}}, {"p_inf", {2.2}}, {"E", {2e8}}, {"p", {2.6}}, {"tau", {1e-3}}}),
          1e-5, 1e-12);
}

TEST_CASE("dunlop pressed slowly is the rate-independent history, with its residual compression") {
  const double k = 3e4;
  const auto spring = std::make_shared<Linear>(k, 0.1);
  const auto history = make_history_law(
      "dunlop", {{"f_c", {0.0, 0.5, 1.0, 2.0}}, {"phi", {0.0, 0.2, 0.2, 0.2}}}, spring);
  compare(Dunlop{k, 1.0, 0.2, 0.5, 1.0, 2.0, 1.0}, *history, 1.0, 1e-3, 400);
  // Let go, each block stays where its friction holds it: s = f/(1 - phi).
  const ContactLaw law(Dunlop{k, 1.0, 0.2, 0.5, 1.0, 2.0, 1.0});
  LawPath path(law);
  for (const double e : {2e-4, 4e-4, 6e-4, 1e-3, 5e-4, 0.0, 0.0}) path.step(e, 1.0);
  for (std::size_t i = 0; i < 3; ++i) {
    const double friction[] = {0.5, 1.0, 2.0};
    CHECK(path.state()[i] == doctest::Approx(friction[i] / 0.8 / (4.0 * k)).epsilon(1e-3));
  }
}

TEST_CASE("Kelvin-Voigt in closed form") {
  const ContactLaw law(KelvinVoigt{8e3, 3.0});
  CHECK(law.evaluate(1e-3, 0.5).force == 8.0 + 1.5);
  CHECK(law.evaluate(1e-3, -3.0).force == 0.0);
  CHECK(law.evaluate(-1e-9, 3.0).force == 0.0);
  CHECK(law.stored_energy(1e-3) == 4e-3);
  CHECK(law.dissipated_power(1e-3, -0.5) == doctest::Approx(0.75).epsilon(1e-12));
}

TEST_CASE("a rate term of the pair relaxes along a path") {
  ExponentialPair pair{kUp, kDown};
  pair.rate_amplitude = 0.3;
  pair.rate_time = 2e-3;
  const ContactLaw law(pair);
  LawPath path(law);
  const double rest = law.static_force(5e-4).force;
  CHECK(path.step(5e-4, 1e-6) == doctest::Approx(1.3 * rest).epsilon(1e-3));
  CHECK(path.step(5e-4, 0.1) == doctest::Approx(rest).epsilon(1e-6));
}

TEST_CASE("formulas: values, exact slopes, order of operations") {
  const std::map<std::string, double> p{{"k", 3.0}, {"n", 2.0}};
  const auto value = [&](const char* text) { return Formula(text, p).evaluate(0.5, -2.0).force; };
  CHECK(value("1 + 2*3 - 4/2") == 5.0);
  CHECK(value("-2^2") == -4.0);
  CHECK(value("2^3^2") == 512.0);
  CHECK(value("2^-1") == 0.5);
  CHECK(value("--3 + +1") == 4.0);
  CHECK(value("8/4/2") == 1.0);
  CHECK(value("10 - 4 - 3") == 3.0);
  CHECK(value("1.5e2 + .5") == 150.5);
  CHECK(value("max(e, rate) + min(k, n) + pow(n, 3)") == 10.5);
  CHECK(value("sign(rate) + abs(rate)*sign(0)") == -1.0);
  CHECK(value("exp(0) + log(1) + sqrt(4) + tanh(0)") == 3.0);
}

TEST_CASE("slopes of formulas are difference quotients") {
  const std::map<std::string, double> p{{"k", 3.0}, {"n", 2.3}};
  for (const char* text :
       {"k*e^n*(1 + 0.3*rate)", "exp(k*e)*tanh(rate)", "log(1 + e)/sqrt(e)", "e^rate", "n^(e*rate)",
        "abs(rate)*max(e, 0.1)", "pow(e, n)/(1 - e/2)", "-(e - rate)^3", "min(e, k)*sign(rate)"}) {
    CAPTURE(text);
    const Formula formula(text, p);
    for (const double e : {0.2, 0.7}) {
      for (const double rate : {-1.3, 0.4}) {
        const LawValue v = formula.evaluate(e, rate);
        const double h = 1e-6;
        const auto f = [&](double x, double r) { return formula.evaluate(x, r).force; };
        CHECK(v.d_compression ==
              doctest::Approx((f(e + h, rate) - f(e - h, rate)) / (2 * h)).epsilon(1e-7));
        CHECK(v.d_rate ==
              doctest::Approx((f(e, rate + h) - f(e, rate - h)) / (2 * h)).epsilon(1e-7));
      }
    }
  }
}

TEST_CASE("faults of formulas are told with their place") {
  const std::map<std::string, double> p{{"k", 3.0}};
  CHECK(fault_of("", p) == "column 1: is empty");
  CHECK(fault_of("k*e + ", p) == "column 7: got the end, expected a number, a name or '('");
  CHECK(fault_of("k*(e + 1", p) == "column 9: got the end, expected ')'");
  CHECK(fault_of("k e", p) == "column 3: got 'e', expected an operator or the end");
  CHECK(fault_of("kk*e", p).find("column 1: unknown name 'kk'; known are e, rate, pi, k, exp") ==
        0);
  CHECK(fault_of("pow(e)", p) == "column 6: got ')', expected ',': pow takes 2 arguments");
  CHECK(fault_of("exp(e, 2)", p) == "column 6: got ',', expected ')'");
  CHECK(fault_of("exp e", p) == "column 5: got 'e', expected '(' after exp");
  CHECK(fault_of("k*\xD0\xB5", p) ==  // a letter of two bytes is told whole
        "column 3: got '\xD0\xB5', expected a number, a name or '('");
  CHECK(fault_of(std::string(1, '\0'), p) ==
        "column 1: got a control character, expected a number, a name or '('");
  CHECK(fault_of("1.2.3", p) == "column 1: got 1.2.3, expected a finite number");
  CHECK(fault_of("1e999", p) == "column 1: got 1e999, expected a finite number");
  CHECK(fault_of("__import__('os')", p).find("column 1: unknown name '__import__'") == 0);
  CHECK(fault_of(std::string(1001, '1'), p) == "has 1001 letters, at most 1000 are accepted");
  CHECK(fault_of(std::string(200, '(') + "e" + std::string(200, ')'), p).find("deep") !=
        std::string::npos);
  CHECK(fault_of(std::string(200, '-') + "e", p).find("deep") != std::string::npos);
  CHECK(fault_of("e", {{"rate", 1.0}}) == "parameter 'rate': the name has a meaning already");
  CHECK(fault_of("e", {{"2k", 1.0}}).find("expected a name of letters") != std::string::npos);
  CHECK(fault_of("e", {{"k", NAN}}).find("must be finite") != std::string::npos);
  // As deep as is accepted runs on the stack that there is.
  std::string deep = "e";
  for (int i = 0; i < 12; ++i) deep = "1+2*3^(" + deep + ")";
  CHECK(fault_of(deep, p).empty());
  CHECK(Formula(deep, p).evaluate(0.1, 0.0).force > 1.0);
  try {
    const ContactLaw law(Expression{"k*q", {{"k", 1.0}}, {}});
    CHECK(false);
  } catch (const InvalidParameter& error) {
    CHECK(std::string(error.what()).find("expression: force: column 3: unknown name 'q'") == 0);
  }
}

TEST_CASE("an expression never pulls, and what is no number stays none") {
  const ContactLaw law(Expression{"k*e*(1 + rate)", {{"k", 1e4}}, {}});
  CHECK(law.evaluate(1e-3, -2.0).force == 0.0);
  CHECK(law.evaluate(-1e-3, 2.0).force == 0.0);
  const ContactLaw broken(Expression{"log(e - 1)", {}, {}});
  CHECK(std::isnan(broken.evaluate(1e-3, 0.0).force));
  CHECK(std::isnan(ContactLaw(Expression{"max(0, log(e - 1))", {}, {}}).evaluate(1e-3, 0.0).force));
}
