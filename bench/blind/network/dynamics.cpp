#include "dynamics.hpp"

#include <algorithm>
#include <cmath>

#include "feltmb/numeric/floor_within.hpp"

namespace feltmb::lumped {
namespace {

/// Argument beyond which 1 / (1 + exp(-x)) is 1 in double precision.
constexpr double shut = 38.0;

std::size_t at(int i) { return static_cast<std::size_t>(i); }

}  // namespace

Dynamics::Dynamics(const Network& network, std::span<const double> parameters,
                   const std::vector<std::vector<std::size_t>>& columns,
                   const std::vector<bool>& moving)
    : net_(network),
      p_(parameters),
      columns_(columns),
      with_slopes_(!columns.empty()),
      n_q_(network.masses.size()) {
  n_ = 2 * n_q_;
  for (const Hidden& h : net_.hidden) {
    place_.push_back(n_);
    n_ += h.mode ? 2 : 1;
  }
  for (std::size_t i = 0; i < n_; ++i) {
    rate_of_.push_back(i < n_q_ ? i + n_q_ : i);
    if (i < 2 * n_q_) {
      live_.push_back(i);
    }
  }
  for (std::size_t h = 0; h < net_.hidden.size(); ++h) {
    const Hidden& hidden = net_.hidden[h];
    Number time = sum(hidden.time);
    hidden_.push_back(
        {sum(hidden.gain), hidden.mode ? time : reciprocal(time), sum(hidden.damping)});
    const std::size_t j = place_[h];
    if (hidden.mode) {
      rate_of_[j] = j + 1;
    }
    // What is fed by nothing and starts at zero stays there.
    if (!hidden_[h][0].dead() || moving[j] || (hidden.mode && moving[j + 1])) {
      live_hidden_.push_back(h);
      live_.push_back(j);
      if (hidden.mode) {
        live_.push_back(j + 1);
      }
    }
  }
  for (const Sum& m : net_.masses) {
    inverse_mass_.push_back(reciprocal(sum(m)));
  }
  for (const Element& e : net_.elements) {
    Values x;
    x.offset = sum(e.travel.offset);
    x.a = sum(e.a);
    x.b = sum(e.b);
    x.c = sum(e.c);
    x.d = sum(e.d);
    if (e.kind == Kind::friction && !e.b.empty()) {
      x.c = reciprocal(x.c);
    }
    for (const Gate& g : e.gates) {
      x.gate_offset.push_back(sum(g.travel.offset));
      x.gate_slope.push_back(reciprocal(sum(g.width)));
    }
    // What is zero and not differentiated by takes no part: an absent effect costs nothing.
    const bool gone = e.kind == Kind::spring     ? x.a.dead() && x.b.dead() && x.c.dead()
                      : e.kind == Kind::friction ? x.a.dead() && x.b.dead() && x.d.dead()
                      : e.kind == Kind::contact  ? x.a.dead()
                                                 : e.travel.input == 0.0 && x.a.dead();
    x.cubic = !x.c.dead();
    x.damped = !x.b.dead();
    x.quadratic = !x.d.dead();
    if (!gone) {
      present_.push_back(elements_.size());
    }
    elements_.push_back(x);
  }
  forces_.resize(net_.elements.size());
  push_.resize(n_q_);
  fed_.resize(net_.hidden.size());
  by_columns_.resize(n_);
  by_states_.resize(n_ * n_);
  gain_ = sum(net_.input.gain);
  gain_.v = 1.0 + gain_.v;
  offset_ = sum(net_.input.offset);
  delay_ = sum(net_.input.delay);
}

Number Dynamics::sum(const Sum& terms) const {
  Number r;
  for (const Weight& w : terms) {
    r.v += w.factor * p_[at(w.index)];
    if (with_slopes_ && w.factor != 0.0) {
      for (const std::size_t column : columns_[at(w.index)]) {
        r.d.push_back({column, w.factor});
      }
    }
  }
  return r;
}

void Dynamics::set_input(std::span<const double> u, double t) {
  const double h = net_.sample_time;
  const double x = t + delay_.v / h;
  const auto n = static_cast<std::ptrdiff_t>(u.size());
  const std::ptrdiff_t k = floor_within<std::ptrdiff_t>(x, -3, n + 2);
  const double s = x - std::floor(x);
  const auto sample = [&](std::ptrdiff_t i) {
    return u[static_cast<std::size_t>(std::clamp<std::ptrdiff_t>(i, 0, n - 1))];
  };
  const double a = sample(k - 1);
  const double b = sample(k);
  const double c = sample(k + 1);
  const double d = sample(k + 2);
  const double c1 = 0.5 * (c - a);
  const double c2 = a - 2.5 * b + 2.0 * c - 0.5 * d;
  const double c3 = 0.5 * (d - a) + 1.5 * (b - c);
  const double u0 = b + s * (c1 + s * (c2 + s * c3));
  const double u1 = (c1 + s * (2.0 * c2 + s * 3.0 * c3)) / h;
  const double u2 = (2.0 * c2 + 6.0 * s * c3) / (h * h);
  const double share = 1.0 / gain_.v;
  input_ = share * (u0 - offset_.v);
  input_rate_ = share * u1;
  if (with_slopes_) {
    input_d_.clear();
    append(input_d_, -share * input_, gain_.d);
    append(input_d_, share * u1, delay_.d);
    append(input_d_, -share, offset_.d);
    input_rate_d_.clear();
    append(input_rate_d_, -share * input_rate_, gain_.d);
    append(input_rate_d_, share * u2, delay_.d);
  }
}

void Dynamics::set_unknown(std::span<const double> knots, double x) {
  const std::size_t m = knots.size() / n_q_;
  unknown_.resize(m > 0 ? n_q_ : 0);
  for (std::size_t i = 0; i < unknown_.size(); ++i) {
    const double place = std::clamp(x, 0.0, 1.0) * static_cast<double>(m - 1);
    const auto k = floor_within<std::size_t>(place, 0, m > 1 ? m - 2 : 0);
    const double s = place - static_cast<double>(k);
    const double next = knots[i * m + std::min(k + 1, m - 1)];
    unknown_[i] = (1.0 - s) * knots[i * m + k] + s * next;
  }
}

Moved Dynamics::moved(const Travel& t, double offset, const double* x, const double* dx) const {
  Moved m{offset, 0.0};
  for (const Weight& w : t.coordinates) {
    m.d += w.factor * x[w.index];
    m.rate += w.factor * x[at(w.index) + n_q_];
  }
  for (const Weight& w : t.hidden) {
    const std::size_t j = place(w.index);
    m.d += w.factor * x[j];
    if (dx != nullptr) {
      m.rate += w.factor * dx[j];
    } else if (net_.hidden[at(w.index)].mode) {
      m.rate += w.factor * x[j + 1];
    }
  }
  if (t.input != 0.0) {
    m.d += t.input * input_;
    m.rate += t.input * input_rate_;
  }
  return m;
}

void Dynamics::append_travel(const Travel& t, const Slopes& offset, double by_place, double by_rate,
                             Slopes& states, Slopes& columns) const {
  for (const Weight& w : t.coordinates) {
    states.push_back({at(w.index), by_place * w.factor});
    if (by_rate != 0.0) {
      states.push_back({at(w.index) + n_q_, by_rate * w.factor});
    }
  }
  for (const Weight& w : t.hidden) {
    const std::size_t j = place(w.index);
    states.push_back({j, by_place * w.factor});
    if (by_rate != 0.0 && net_.hidden[at(w.index)].mode) {
      states.push_back({j + 1, by_rate * w.factor});
    }
  }
  append(columns, by_place, offset);
  if (t.input != 0.0) {
    append(columns, by_place * t.input, input_d_);
    append(columns, by_rate * t.input, input_rate_d_);
  }
}

double Dynamics::place_along(const Travel& t, double offset, const double* x) const {
  double d = offset;
  for (const Weight& w : t.coordinates) {
    d += w.factor * x[w.index];
  }
  for (const Weight& w : t.hidden) {
    d += w.factor * x[place(w.index)];
  }
  return d + t.input * input_;
}

void Dynamics::evaluate(const Element& e, const Values& p, const double* x, Force& out) {
  out.f = 0.0;
  out.acts = false;
  out.states.clear();
  out.columns.clear();
  if (e.kind == Kind::contact) {
    evaluate_contact(e, p, x, out);
    return;
  }
  out.acts = true;
  if (e.kind == Kind::drive) {
    out.f += -1.0 * p.a.v;
    append(out.columns, -1.0, p.a.d);
    if (e.travel.input != 0.0) {
      out.f += -e.travel.input * input_;
      append(out.columns, -e.travel.input, input_d_);
    }
    return;
  }
  const Moved m = moved(e.travel, p.offset.v, x, nullptr);
  if (e.kind == Kind::spring) {
    const double cube = m.d * m.d * m.d;
    out.f = m.d * p.a.v;
    if (p.cubic) {
      out.f += p.c.v * cube;
    }
    if (p.damped) {
      out.f += p.b.v * m.rate;
    }
    if (with_slopes_) {
      append_travel(e.travel, p.offset.d, p.a.v + 3.0 * p.c.v * m.d * m.d, p.b.v, out.states,
                    out.columns);
      append(out.columns, m.d, p.a.d);
      append(out.columns, cube, p.c.d);
      append(out.columns, m.rate, p.b.d);
    }
    return;
  }
  const double square = m.rate * std::abs(m.rate);
  double slope = p.a.v;
  out.f = p.a.v * m.rate;
  if (p.damped) {
    const double t = std::tanh(m.rate * p.c.v);
    const double along = p.b.v * (1.0 - t * t);
    out.f += p.b.v * t;
    slope += along * p.c.v;
    if (with_slopes_) {
      append(out.columns, t, p.b.d);
      append(out.columns, along * m.rate, p.c.d);
    }
  }
  if (p.quadratic) {
    out.f += p.d.v * square;
    slope += 2.0 * p.d.v * std::abs(m.rate);
  }
  if (with_slopes_) {
    append_travel(e.travel, p.offset.d, 0.0, slope, out.states, out.columns);
    append(out.columns, m.rate, p.a.d);
    append(out.columns, square, p.d.d);
  }
}

void Dynamics::evaluate_contact(const Element& e, const Values& p, const double* x, Force& out) {
  // Seen early: whether there is contact at all.
  if (!(place_along(e.travel, p.offset.v, x) > 0.0)) {
    return;
  }
  for (std::size_t g = 0; g < e.gates.size(); ++g) {
    if (place_along(e.gates[g].travel, p.gate_offset[g].v, x) * p.gate_slope[g].v < -shut) {
      return;
    }
  }
  const Moved m = moved(e.travel, p.offset.v, x, nullptr);
  const double loss = 1.0 + p.c.v * m.rate;
  if (loss <= 0.0) {
    return;
  }
  const double power = std::pow(m.d, p.b.v);
  out.acts = true;
  out.f = p.a.v * power * loss;
  double open = 1.0;  // product of the gates
  for (std::size_t g = 0; g < e.gates.size(); ++g) {
    const Moved seen = moved(e.gates[g].travel, p.gate_offset[g].v, x, nullptr);
    const double d = seen.d * p.gate_slope[g].v;
    if (d < shut) {
      const double s = 0.5 * (1.0 + std::tanh(0.5 * d));
      out.f = out.f * s;
      open *= s;
    }
  }
  if (!with_slopes_) {
    return;
  }
  const double whole = p.a.v * power * open;
  append_travel(e.travel, p.offset.d, p.b.v * (p.a.v * power / m.d) * loss * open, whole * p.c.v,
                out.states, out.columns);
  append(out.columns, power * loss * open, p.a.d);
  if (!p.b.d.empty()) {
    append(out.columns, whole * std::log(m.d) * loss, p.b.d);
  }
  append(out.columns, whole * m.rate, p.c.d);
  for (std::size_t g = 0; g < e.gates.size(); ++g) {
    const Gate& gate = e.gates[g];
    const Moved seen = moved(gate.travel, p.gate_offset[g].v, x, nullptr);
    const double d = seen.d * p.gate_slope[g].v;
    if (d < shut) {
      const double s = 0.5 * (1.0 + std::tanh(0.5 * d));
      const double slope = out.f * (1.0 - s);
      append_travel(gate.travel, p.gate_offset[g].d, slope * p.gate_slope[g].v, 0.0, out.states,
                    out.columns);
      append(out.columns, slope * seen.d, p.gate_slope[g].d);
    }
  }
}

void Dynamics::rates(const double* x, double* dx) {
  for (std::size_t i = 0; i < n_q_; ++i) {
    dx[i] = x[i + n_q_];
    push_[i] = unknown_.empty() ? 0.0 : unknown_[i];
  }
  for (const std::size_t e : present_) {
    evaluate(net_.elements[e], elements_[e], x, forces_[e]);
    if (forces_[e].acts) {
      for (const Weight& w : net_.elements[e].travel.coordinates) {
        push_[at(w.index)] += -w.factor * forces_[e].f;
      }
    }
  }
  for (std::size_t i = 0; i < n_q_; ++i) {
    dx[i + n_q_] = push_[i] * inverse_mass_[i].v;
  }
  for (const std::size_t h : live_hidden_) {
    const std::size_t j = place_[h];
    double f = 0.0;
    for (const int source : net_.hidden[h].sources) {
      f += 1.0 * forces_[at(source)].f;
    }
    fed_[h] = f;
    f = hidden_[h][0].v * f - x[j];
    const double w = hidden_[h][1].v;
    if (net_.hidden[h].mode) {
      const double damping = hidden_[h][2].v * x[j + 1];
      dx[j] = x[j + 1];
      dx[j + 1] = w * (w * f - damping - damping);
    } else {
      dx[j] = w * f;
    }
  }
  if (with_slopes_) {
    linearize(x);
  }
}

void Dynamics::linearize(const double* x) {
  std::fill(by_states_.begin(), by_states_.end(), 0.0);
  for (const std::size_t i : live_) {
    by_columns_[i].clear();
  }
  for (const std::size_t e : present_) {
    const Force& force = forces_[e];
    if (!force.acts) {
      continue;
    }
    for (const Weight& w : net_.elements[e].travel.coordinates) {
      const std::size_t i = at(w.index);
      const double factor = -w.factor * inverse_mass_[i].v;
      double* row = by_states_.data() + (i + n_q_) * n_;
      for (const Slope& s : force.states) {
        row[s.index] += factor * s.value;
      }
      append(by_columns_[i + n_q_], factor, force.columns);
    }
  }
  for (std::size_t i = 0; i < n_q_; ++i) {
    append(by_columns_[i + n_q_], push_[i], inverse_mass_[i].d);
  }
  for (const std::size_t h : live_hidden_) {
    linearize_hidden(h, x);
  }
}

void Dynamics::linearize_hidden(std::size_t h, const double* x) {
  const Hidden& hidden = net_.hidden[h];
  const auto& [gain, speed, damping] = hidden_[h];
  const std::size_t j = place_[h];
  const std::size_t to = hidden.mode ? j + 1 : j;
  double* row = by_states_.data() + to * n_;
  Slopes& columns = by_columns_[to];
  const double w = speed.v;
  const double lead = hidden.mode ? w * w : w;
  const double f = gain.v * fed_[h] - x[j];
  for (const int source : hidden.sources) {
    for (const Slope& s : forces_[at(source)].states) {
      row[s.index] += lead * gain.v * s.value;
    }
    append(columns, lead * gain.v, forces_[at(source)].columns);
  }
  append(columns, lead * fed_[h], gain.d);
  row[j] -= lead;
  if (hidden.mode) {
    row[j + 1] -= 2.0 * w * damping.v;
    append(columns, 2.0 * (w * f - damping.v * x[j + 1]), speed.d);
    append(columns, -2.0 * w * x[j + 1], damping.d);
  } else {
    append(columns, f, speed.d);
  }
}

}  // namespace feltmb::lumped
