#include "feltmb/fiber/history.hpp"

#include <algorithm>
#include <cmath>

#include "feltmb/fiber/faults.hpp"
#include "feltmb/numeric/constants.hpp"

namespace feltmb {
namespace {

using Lists = std::map<std::string, std::vector<double>>;

/// Weights of x' = (u - x)/tau over a step in which u is linear: x1 = a x0 + w0 u0 + w1 u1.
struct LagWeights {
  double a, w0, w1;
  LagWeights(double dt, double tau) {
    const double h = dt / tau;
    a = std::exp(-h);
    const double mean = h < 1e-6 ? 1.0 - 0.5 * h : -std::expm1(-h) / h;
    w0 = mean - a;
    w1 = 1.0 - mean;
  }
};

double power(double x, double p) { return x > 0.0 ? std::pow(x, p) : 0.0; }

/// Dunlop's units, alone or with a Kelvin element in series (compliance > 0).
class DunlopLaw final : public HistoryLaw {
 public:
  DunlopLaw(std::shared_ptr<const CompressionLaw> spring, std::vector<double> friction,
            std::vector<double> slope, double kelvin_modulus, double kelvin_viscosity)
      : spring_(std::move(spring)),
        friction_(std::move(friction)),
        slope_(std::move(slope)),
        modulus_(kelvin_modulus),
        viscosity_(kelvin_viscosity),
        v_max_(std::min(1.0, spring_->limit() * (1.0 - 1e-9))) {
    top_ = spring_->pressure(v_max_);
    DunlopLaw::reset();
  }
  void reset() override {
    unit_.assign(friction_.size(), 0.0);
    stress_ = 0.0;
    kelvin_ = 0.0;
  }
  double step(double dt, double x, double /*rate*/) override {
    if (!(x < 1.0 - spring_->reference() / v_max_)) {
      throw InvalidParameter(
          format("history law: compression = %.6g, must be < %.6g (strain at which the spring's "
                 "volume fraction reaches %.6g)",
                 x, 1.0 - spring_->reference() / v_max_, v_max_));
    }
    double kelvin_base = 0.0;
    double kelvin_share = 0.0;
    if (modulus_ > 0.0) {
      const LagWeights lag(dt, viscosity_ / modulus_);
      kelvin_base = lag.a * kelvin_ + lag.w0 * stress_ / modulus_;
      kelvin_share = lag.w1 / modulus_;
      if (dt == 0.0) kelvin_base = kelvin_;
    }
    const auto excess = [&](double stress) {
      return total_strain(stress) + kelvin_base + kelvin_share * stress - x;
    };
    // Strain grows with stress; flat where every unit sticks. Stay as near the old stress as can
    // be.
    double low = 0.0;
    double high = stress_;
    const double here = excess(stress_);
    double found;
    if (here == 0.0) {
      found = stress_;
    } else {
      if (here < 0.0) {
        low = stress_;
        high = std::max(2.0 * stress_, 1e-9 * top_);
        while (excess(high) < 0.0) {
          low = high;
          high *= 2.0;
          if (high > 1e6 * top_ + 1e12) break;
        }
      } else if (excess(0.0) > 0.0) {
        // The felt has lost contact: it stands back behind the surface that left it.
        high = 0.0;
      }
      const bool rising = here < 0.0;
      for (int i = 0; i < 200 && high - low > 1e-15 * high; ++i) {
        const double middle = 0.5 * (low + high);
        if (middle <= low || middle >= high) break;
        const double value = excess(middle);
        // On a flat stretch keep the end nearer to the old stress.
        const bool up = rising ? value < 0.0 : value <= 0.0;
        (up ? low : high) = middle;
      }
      found = rising ? high : low;
    }
    for (std::size_t i = 0; i < unit_.size(); ++i) unit_[i] = clamp_unit(i, found);
    kelvin_ = kelvin_base + kelvin_share * found;
    stress_ = found;
    return found;
  }

 private:
  [[nodiscard]] double clamp_unit(std::size_t i, double stress) const {
    const double low = std::max(0.0, (stress - friction_[i]) / (1.0 + slope_[i]));
    const double high = (stress + friction_[i]) / (1.0 - slope_[i]);
    return std::clamp(unit_[i], low, high);
  }
  [[nodiscard]] double total_strain(double stress) const {
    double sum = 0.0;
    for (std::size_t i = 0; i < unit_.size(); ++i) {
      const double s = clamp_unit(i, stress);
      const double v = s >= top_ ? v_max_ : spring_->volume_fraction(s, v_max_);
      // Beyond the law's end the unit is solid; a linear tail keeps the root finder going.
      const double tail = s > top_ ? 1e-3 * (s - top_) / top_ : 0.0;
      sum += 1.0 - spring_->reference() / v + tail;
    }
    return sum / static_cast<double>(unit_.size());
  }
  std::shared_ptr<const CompressionLaw> spring_;
  std::vector<double> friction_, slope_;
  double modulus_, viscosity_, v_max_, top_ = 0.0;
  std::vector<double> unit_;
  double stress_ = 0.0;
  double kelvin_ = 0.0;
};

class MaxwellLaw final : public HistoryLaw {
 public:
  MaxwellLaw(double modulus, double exponent, std::vector<double> moduli,
             std::vector<double> exponents, std::vector<double> times)
      : modulus_(modulus),
        exponent_(exponent),
        moduli_(std::move(moduli)),
        exponents_(std::move(exponents)),
        times_(std::move(times)) {
    MaxwellLaw::reset();
  }
  void reset() override {
    stress_.assign(moduli_.size(), 0.0);
    x_ = 0.0;
  }
  double step(double dt, double x, double /*rate*/) override {
    double total = modulus_ * power(x, exponent_);
    for (std::size_t i = 0; i < moduli_.size(); ++i) {
      const double jump = moduli_[i] * (power(x, exponents_[i]) - power(x_, exponents_[i]));
      if (dt > 0.0) {
        const double h = dt / times_[i];
        const double mean = h < 1e-6 ? 1.0 - 0.5 * h : -std::expm1(-h) / h;
        stress_[i] = stress_[i] * std::exp(-h) + jump * mean;
      } else {
        stress_[i] += jump;
      }
      total += stress_[i];
    }
    x_ = x;
    return std::max(0.0, total);
  }

 private:
  double modulus_, exponent_;
  std::vector<double> moduli_, exponents_, times_, stress_;
  double x_ = 0.0;
};

class StulovLaw final : public HistoryLaw {
 public:
  StulovLaw(double stiffness, double exponent, double amplitude, double time)
      : stiffness_(stiffness), exponent_(exponent), amplitude_(amplitude), time_(time) {}
  void reset() override { memory_ = last_ = 0.0; }
  double step(double dt, double x, double /*rate*/) override {
    const double now = power(x, exponent_);
    const LagWeights lag(dt, time_);
    if (dt > 0.0) memory_ = lag.a * memory_ + lag.w0 * last_ + lag.w1 * now;
    last_ = now;
    return x > 0.0 ? std::max(0.0, stiffness_ * (now - amplitude_ * memory_)) : 0.0;
  }

 private:
  double stiffness_, exponent_, amplitude_, time_, memory_ = 0.0, last_ = 0.0;
};

/// Laws whose force depends on x and dx/dt only.
class ImpactLaw final : public HistoryLaw {
 public:
  enum class Kind { stulov_differential, linear_in_rate };
  ImpactLaw(Kind kind, double stiffness, double exponent, double damping)
      : kind_(kind), stiffness_(stiffness), exponent_(exponent), damping_(damping) {}
  void reset() override {}
  double step(double /*dt*/, double x, double rate) override {
    if (!(x > 0.0)) return 0.0;
    const double spring = power(x, exponent_);
    const double damped = kind_ == Kind::stulov_differential
                              ? spring + damping_ * exponent_ * power(x, exponent_ - 1.0) * rate
                              : spring * (1.0 + damping_ * rate);
    return std::max(0.0, stiffness_ * damped);
  }

 private:
  Kind kind_;
  double stiffness_, exponent_, damping_;
};

std::vector<LawDescription> make_history_descriptions() {
  const auto positive = [](const char* name, const char* unit, const char* meaning) {
    return LawParameter{name, unit, kNaN, 0, 1e18, true, 1e-6, 1e15, true, meaning};
  };
  const LawParameter friction{
      "f_c", "Pa", kNaN, 0,     1e12,
      false, 0,    1e9,  false, "constant part of the sliding stress, one value per unit"};
  const LawParameter slope{
      "phi", "", 0.0, 0,     0.999,
      false, 0,  0.9, false, "sliding stress per spring stress, one value per unit or one for all"};
  std::vector<LawDescription> all;
  all.push_back({"dunlop",
                 "Dunlop: spring-slider units in series",
                 "thesis 2.2.3; Dunlop [23]",
                 "rate independent; judged form",
                 {friction, slope}});
  all.push_back({"stamm_kelvin",
                 "Stamm: Dunlop in series with a Kelvin element",
                 "thesis 2.2.3; Stamm [100]",
                 "judged form",
                 {friction, slope, positive("G", "Pa", "Kelvin spring"),
                  positive("c", "Pa s", "Kelvin dashpot")}});
  all.push_back(
      {"maxwell",
       "Maxwell relaxation with nonlinear springs",
       "thesis 2.2.3; Sajn [116]",
       "one branch: three components",
       {positive("E_inf", "Pa", "spring in parallel"), positive("p_inf", "", "its exponent"),
        positive("E", "Pa", "springs of the branches"),
        positive("p", "", "their exponents, one value per branch or one for all"),
        positive("tau", "s", "relaxation times")}});
  const LawParameter exponent = positive("exponent", "", "p, of the compression");
  all.push_back({"stulov",
                 "Stulov: hereditary law, four parameters",
                 "thesis eq. 2.11; Stulov [104-106]",
                 "x below the felt's thickness",
                 {positive("stiffness", "N/m^p", "F0, instantaneous"),
                  exponent,
                  {"amplitude", "", kNaN, 0, 0.999999, false, 0, 0.999, false, "epsilon"},
                  positive("time", "s", "tau0, relaxation time")}});
  all.push_back({"stulov_differential",
                 "Stulov: three parameters, slow limit",
                 "thesis eq. 2.12; Stulov [104-106]",
                 "slow against tau0",
                 {positive("stiffness", "N/m^p", "F0, static"),
                  exponent,
                  {"time", "s", kNaN, 0, 1e6, false, 0, 1, false, "alpha, retarded time"}}});
  const LawParameter stiffness = positive("stiffness", "N/m^p", "K");
  const LawParameter hertz{"exponent", "", 1.5, 0, 20, true, 1, 6, false, "n; 3/2 Hertz"};
  all.push_back(
      {"hunt_crossley",
       "Hunt and Crossley",
       "thesis 2.3; Hunt, Crossley [38]",
       "no adhesion: force is cut at 0",
       {stiffness, hertz, {"damping", "s/m", kNaN, 0, 1e6, false, 0, 10, false, "alpha"}}});
  all.push_back({"lankarani_nikravesh",
                 "Lankarani and Nikravesh",
                 "thesis 2.3; Lankarani, Nikravesh [55]",
                 "restitution near 1",
                 {stiffness,
                  hertz,
                  {"restitution", "", kNaN, 0, 1, false, 0.3, 1, false, "its coefficient"},
                  positive("impact_speed", "m/s", "dx/dt at first touch")}});
  return all;
}

}  // namespace

const std::vector<LawDescription>& history_descriptions() {
  static const auto& all = *new std::vector<LawDescription>(make_history_descriptions());
  return all;
}

std::unique_ptr<HistoryLaw> make_history_law(const std::string& name, const Lists& parameters,
                                             std::shared_ptr<const CompressionLaw> spring) {
  const LawDescription* description = nullptr;
  std::string list;
  for (const LawDescription& law : history_descriptions()) {
    if (law.name == name) description = &law;
    list += (list.empty() ? "" : ", ") + law.name;
  }
  if (description == nullptr) {
    throw InvalidParameter("history law: model = \"" + name + "\", must be one of " + list);
  }
  Faults faults("history law \"" + name + "\"");
  Lists values;
  std::string known;
  for (const LawParameter& p : description->parameters) {
    known += (known.empty() ? "" : ", ") + p.name;
  }
  for (const auto& given : parameters) {
    const bool found = std::any_of(description->parameters.begin(), description->parameters.end(),
                                   [&](const LawParameter& p) { return p.name == given.first; });
    if (!found) {
      faults.add_text("unknown parameter \"" + given.first + "\", expected only " + known);
    }
  }
  const bool many_units = name == "dunlop" || name == "stamm_kelvin" || name == "maxwell";
  for (const LawParameter& p : description->parameters) {
    const auto found = parameters.find(p.name);
    if (found == parameters.end() || found->second.empty()) {
      if (std::isnan(p.default_value)) {
        faults.add_text("parameter \"" + p.name + "\" is missing, expected a value" +
                        (p.unit.empty() ? "" : " in " + p.unit) + " (" + p.meaning + ")");
      }
      values[p.name] = {p.default_value};
      continue;
    }
    const bool may_repeat = many_units && (p.name == "f_c" || p.name == "phi" || p.name == "E" ||
                                           p.name == "p" || p.name == "tau");
    if (found->second.size() > 1 && !may_repeat) {
      faults.add_text(format("parameter \"%s\" has %zu values, expected 1", p.name.c_str(),
                             found->second.size()));
    }
    for (double value : found->second) {
      if (!((p.low_open ? value > p.low : value >= p.low) && value <= p.high)) {
        faults.add(p.name.c_str(), value, p.unit.c_str(),
                   format("%s %.6g and <= %.6g", p.low_open ? ">" : ">=", p.low, p.high),
                   p.meaning);
      }
    }
    values[p.name] = found->second;
  }
  const auto repeat = [&](const char* key, std::size_t n) {
    std::vector<double>& v = values[key];
    if (v.size() == 1) v.assign(n, v[0]);
    if (v.size() != n) {
      faults.add_text(
          format("parameter \"%s\" has %zu values, expected 1 or %zu", key, v.size(), n));
    }
  };
  if (name == "dunlop" || name == "stamm_kelvin") {
    if (!spring) faults.add_text("needs a spring, expected a compression law");
    repeat("phi", values["f_c"].size());
    faults.raise_if_any();
    const bool kelvin = name == "stamm_kelvin";
    return std::make_unique<DunlopLaw>(std::move(spring), values["f_c"], values["phi"],
                                       kelvin ? values["G"][0] : 0.0,
                                       kelvin ? values["c"][0] : 0.0);
  }
  if (name == "maxwell") {
    repeat("p", values["E"].size());
    repeat("tau", values["E"].size());
    faults.raise_if_any();
    return std::make_unique<MaxwellLaw>(values["E_inf"][0], values["p_inf"][0], values["E"],
                                        values["p"], values["tau"]);
  }
  faults.raise_if_any();
  const auto value = [&](const char* key) { return values[key][0]; };
  if (name == "stulov") {
    return std::make_unique<StulovLaw>(value("stiffness"), value("exponent"), value("amplitude"),
                                       value("time"));
  }
  if (name == "stulov_differential") {
    return std::make_unique<ImpactLaw>(ImpactLaw::Kind::stulov_differential, value("stiffness"),
                                       value("exponent"), value("time"));
  }
  const double damping =
      name == "hunt_crossley"
          ? value("damping")
          : 0.75 * (1.0 - value("restitution") * value("restitution")) / value("impact_speed");
  return std::make_unique<ImpactLaw>(ImpactLaw::Kind::linear_in_rate, value("stiffness"),
                                     value("exponent"), damping);
}

void run_history(HistoryLaw& law, std::span<const double> time, std::span<const double> x,
                 std::span<const double> rate, std::span<double> out) {
  Faults faults("history law");
  if (x.size() != time.size() || rate.size() != time.size() || out.size() != time.size()) {
    faults.add_text(format("%zu times, %zu compressions, %zu rates: expected equal numbers",
                           time.size(), x.size(), rate.size()));
    faults.raise_if_any();
  }
  for (std::size_t i = 0; i < time.size(); ++i) {
    if (!std::isfinite(time[i]) || !std::isfinite(x[i]) || !std::isfinite(rate[i])) {
      faults.add_text(format("sample %zu is not finite", i));
      break;
    }
    if (i > 0 && !(time[i] > time[i - 1])) {
      faults.add(format("time[%zu]", i).c_str(), time[i], "s",
                 format("> %.6g s, the time before it", time[i - 1]));
      break;
    }
  }
  faults.raise_if_any();
  law.reset();
  for (std::size_t i = 0; i < time.size(); ++i) {
    out[i] = law.step(i == 0 ? 0.0 : time[i] - time[i - 1], x[i], rate[i]);
  }
}

}  // namespace feltmb
