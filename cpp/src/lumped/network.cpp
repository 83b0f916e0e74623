#include "feltmb/lumped/network.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <optional>

#include "feltmb/core/error.hpp"
#include "feltmb/lumped/dual.hpp"
#include "feltmb/numeric/floor_within.hpp"

namespace feltmb::lumped {
namespace {

std::size_t at(int i) { return static_cast<std::size_t>(i); }

void check_sum(const Sum& sum, int limit, const char* what) {
  for (const Weight& w : sum) {
    if (w.index < 0 || w.index >= limit) {
      throw InvalidParameter(
          format("lumped network: %s refers to number %d of %d", what, w.index, limit));
    }
  }
}

}  // namespace

int Network::states() const {
  int n = 2 * static_cast<int>(masses.size());
  for (const Hidden& h : hidden) {
    n += h.mode ? 2 : 1;
  }
  return n;
}

void Network::check() const {
  const int n_q = static_cast<int>(masses.size());
  const int n_e = static_cast<int>(elements.size());
  const auto travel = [&](const Travel& t, const char* what) {
    check_sum(t.coordinates, n_q, what);
    check_sum(t.hidden, static_cast<int>(hidden.size()), what);
    check_sum(t.offset, parameters, what);
  };
  const auto sums = [&](std::initializer_list<const Sum*> list, const char* what) {
    for (const Sum* s : list) {
      check_sum(*s, parameters, what);
    }
  };
  if (masses.empty() || !(sample_time > 0.0) || substeps < 1) {
    throw InvalidParameter("lumped network: needs a mass, a sample time > 0 and substeps >= 1");
  }
  for (const Sum& m : masses) {
    sums({&m}, "a mass");
  }
  for (const Element& e : elements) {
    travel(e.travel, "an element");
    sums({&e.a, &e.b, &e.c, &e.d}, "an element");
    for (const Gate& g : e.gates) {
      travel(g.travel, "a gate");
      sums({&g.width}, "a gate");
    }
  }
  for (const Hidden& h : hidden) {
    sums({&h.gain, &h.time, &h.damping}, "a hidden state");
    for (const int s : h.sources) {
      check_sum({{s, 1.0}}, n_e, "a source");
    }
  }
  for (const Sensor& s : sensors) {
    travel(s.travel, "a sensor");
    sums({&s.scale, &s.offset, &s.delay, &s.flexibility}, "a sensor");
    if (s.element >= n_e) {
      throw InvalidParameter("lumped network: a sensor refers to an unknown element");
    }
  }
  sums({&input.gain, &input.offset, &input.delay}, "the input");
}

namespace {

bool dead(double a) { return a == 0.0; }
template <int W>
bool dead(const Dual<W>& a) {
  return a.v == 0.0 && std::all_of(a.d.begin(), a.d.end(), [](double x) { return x == 0.0; });
}

template <class S>
struct Moved {
  S d, rate;
};

/// One pass with a fixed number of directions; S is double or Dual<W>.
template <class S>
class Pass {
 public:
  Pass(const Network& network, const std::vector<S>& parameters)
      : net_(network), p_(parameters), n_q_(network.masses.size()) {
    for (const Hidden& h : net_.hidden) {
      place_.push_back(static_cast<int>(n_states_) + 2 * static_cast<int>(n_q_));
      n_states_ += h.mode ? 2 : 1;
    }
    n_states_ += 2 * n_q_;
    for (const Sum& m : net_.masses) {
      inverse_mass_.push_back(S(1.0) / sum(m));
    }
    for (const Element& e : net_.elements) {
      Values x;
      x.offset = sum(e.travel.offset);
      x.a = sum(e.a);
      x.b = sum(e.b);
      x.c = sum(e.c);
      x.d = sum(e.d);
      if (e.kind == Kind::friction && !e.b.empty()) {
        x.c = S(1.0) / x.c;
      }
      for (const Gate& g : e.gates) {
        x.gate_offset.push_back(sum(g.travel.offset));
        x.gate_slope.push_back(S(1.0) / sum(g.width));
      }
      // What is zero and not differentiated by takes no part: an absent effect costs nothing.
      x.gone = e.kind == Kind::spring     ? dead(x.a) && dead(x.b) && dead(x.c)
               : e.kind == Kind::friction ? dead(x.a) && dead(x.b) && dead(x.d)
               : e.kind == Kind::contact  ? dead(x.a)
                                          : e.travel.input == 0.0 && dead(x.a);
      x.cubic = !dead(x.c);
      x.damped = !dead(x.b);
      x.quadratic = !dead(x.d);
      elements_.push_back(x);
    }
    for (const Hidden& h : net_.hidden) {
      hidden_.push_back({sum(h.gain), h.mode ? sum(h.time) : S(1.0) / sum(h.time), sum(h.damping)});
    }
    force_.assign(net_.elements.size(), S(0.0));
    gain_ = S(1.0) + sum(net_.input.gain);
    offset_ = sum(net_.input.offset);
    delay_ = sum(net_.input.delay);
  }

  std::size_t states() const { return n_states_; }
  const std::vector<S>& forces() const { return force_; }
  S sum(const Sum& terms) const {
    S r(0.0);
    for (const Weight& w : terms) {
      add(r, w.factor, p_[at(w.index)]);
    }
    return r;
  }

  /// Corrected input and its rate at the time `t` [samples]: cubic Hermite with centered slopes.
  void set_input(std::span<const double> u, double t) {
    const double h = net_.sample_time;
    const double x = t - value(delay_) / h;
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
    input_ = gain_ * chain(delay_, u0, -u1) + offset_;
    input_rate_ = gain_ * chain(delay_, u1, -u2);
  }

  /// Unknown forces at the share `x` of the segment: knots (coordinates, m).
  void set_unknown(std::span<const double> knots, double x) {
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

  Moved<S> moved(const Travel& t, const S& offset, const S* x, const S* dx) const {
    Moved<S> m{offset, S(0.0)};
    for (const Weight& w : t.coordinates) {
      add(m.d, w.factor, x[w.index]);
      add(m.rate, w.factor, x[at(w.index) + n_q_]);
    }
    for (const Weight& w : t.hidden) {
      const std::size_t j = at(place_[at(w.index)]);
      add(m.d, w.factor, x[j]);
      if (dx != nullptr) {
        add(m.rate, w.factor, dx[j]);
      } else if (net_.hidden[at(w.index)].mode) {
        add(m.rate, w.factor, x[j + 1]);
      }
    }
    if (t.input != 0.0) {
      add(m.d, t.input, input_);
      add(m.rate, t.input, input_rate_);
    }
    return m;
  }

  /// Rates of the states; the input must have been set for this time.
  void rates(const S* x, S* dx) {
    for (std::size_t i = 0; i < n_q_; ++i) {
      dx[i] = x[i + n_q_];
      dx[i + n_q_] = S(unknown_.empty() ? 0.0 : unknown_[i]);
    }
    for (std::size_t e = 0; e < net_.elements.size(); ++e) {
      const Element& element = net_.elements[e];
      if (!force(element, elements_[e], x, force_[e])) {
        continue;
      }
      for (const Weight& w : element.travel.coordinates) {
        add(dx[at(w.index) + n_q_], -w.factor, force_[e]);
      }
    }
    for (std::size_t i = 0; i < n_q_; ++i) {
      dx[i + n_q_] = dx[i + n_q_] * inverse_mass_[i];
    }
    for (std::size_t h = 0; h < net_.hidden.size(); ++h) {
      const std::size_t j = at(place_[h]);
      S f(0.0);
      for (const int source : net_.hidden[h].sources) {
        add(f, 1.0, force_[at(source)]);
      }
      f = hidden_[h][0] * f - x[j];
      const S& w = hidden_[h][1];
      if (net_.hidden[h].mode) {
        S damping = hidden_[h][2] * x[j + 1];
        dx[j] = x[j + 1];
        dx[j + 1] = w * (w * f - damping - damping);
      } else {
        dx[j] = w * f;
      }
    }
  }

 private:
  /// Argument beyond which 1 / (1 + exp(-x)) is 1 in double precision.
  static constexpr double shut = 38.0;

  struct Values {
    S offset, a, b, c, d;
    std::vector<S> gate_offset, gate_slope;
    bool gone = false;
    bool cubic = true;
    bool damped = true;  ///< spring: damping; friction: the dry part
    bool quadratic = true;
  };

  /// Displacement without its derivatives, to see early whether there is contact.
  double place(const Travel& t, const S& offset, const S* x) const {
    double d = value(offset);
    for (const Weight& w : t.coordinates) {
      d += w.factor * value(x[w.index]);
    }
    for (const Weight& w : t.hidden) {
      d += w.factor * value(x[place_[at(w.index)]]);
    }
    return d + t.input * value(input_);
  }

  /// Force of an element; false: there is none.
  bool force(const Element& e, const Values& p, const S* x, S& f) const {
    if (p.gone) {
      return false;
    }
    if (e.kind == Kind::drive) {
      f = S(0.0);
      add(f, -1.0, p.a);
      if (e.travel.input != 0.0) {
        add(f, -e.travel.input, input_);
      }
      return true;
    }
    if (e.kind == Kind::contact) {
      bool open = !(place(e.travel, p.offset, x) > 0.0);
      for (std::size_t g = 0; g < e.gates.size() && !open; ++g) {
        open = place(e.gates[g].travel, p.gate_offset[g], x) * value(p.gate_slope[g]) < -shut;
      }
      if (open) {
        f = S(0.0);
        return false;
      }
    }
    const Moved<S> m = moved(e.travel, p.offset, x, nullptr);
    if (e.kind == Kind::spring) {
      f = m.d * p.a;
      if (p.cubic) {
        f += p.c * (m.d * m.d * m.d);
      }
      if (p.damped) {
        f += p.b * m.rate;
      }
      return true;
    }
    if (e.kind == Kind::friction) {
      f = p.a * m.rate;
      if (p.damped) {
        f += p.b * tanh_of(m.rate * p.c);
      }
      if (p.quadratic) {
        f += p.d * (m.rate * abs_of(m.rate));
      }
      return true;
    }
    const S loss = S(1.0) + p.c * m.rate;
    if (value(loss) <= 0.0) {
      f = S(0.0);
      return false;
    }
    f = p.a * power_of(m.d, p.b) * loss;
    for (std::size_t g = 0; g < e.gates.size(); ++g) {
      const S d = moved(e.gates[g].travel, p.gate_offset[g], x, nullptr).d * p.gate_slope[g];
      if (value(d) < shut) {
        f = f * sigmoid_of(d);
      }
    }
    return true;
  }

  const Network& net_;
  const std::vector<S>& p_;
  std::size_t n_q_;
  std::size_t n_states_ = 0;
  std::vector<int> place_;
  std::vector<S> inverse_mass_;
  std::vector<Values> elements_;
  std::vector<std::array<S, 3>> hidden_;
  std::vector<S> force_;
  std::vector<double> unknown_;
  S gain_, offset_, delay_, input_{}, input_rate_{};
};

void copy_slopes(double /*x*/, double* /*to*/, int /*count*/) {}
template <int W>
void copy_slopes(const Dual<W>& x, double* to, int count) {
  std::copy_n(x.d.begin(), count, to);
}

/// One direction set: columns [first, first + count) of the full result.
struct Columns {
  int first;
  int count;
};

template <class S>
void run_pass(const Network& net, const Request& request, const std::vector<std::vector<S>>& rows,
              const std::vector<S>& starts, const Columns& columns, Batch& out) {
  const std::size_t n = at(net.states());
  const std::size_t n_q = net.masses.size();
  const std::size_t n_y = net.sensors.size();
  const double h = net.sample_time / net.substeps;
  std::vector<S> x(n), stage(n), k1(n), k2(n), k3(n), k4(n);
  std::vector<S> scale(n_y), offset(n_y), delay(n_y), flexibility(n_y), travel_offset(n_y);
  std::optional<Pass<S>> prepared;
  int prepared_row = -1;
  std::vector<Moved<S>> seen;  // (steps + 1, sensors)
  std::vector<S> bent;         // (samples, sensors): force of the sensor's element
  std::size_t row = 0;
  for (std::size_t g = 0; g < request.segments.size(); ++g) {
    const Segment& segment = request.segments[g];
    const std::span<const double> u = request.inputs[at(segment.input)];
    if (segment.row != prepared_row) {
      prepared_row = segment.row;
      prepared.emplace(net, rows[at(segment.row)]);
      for (std::size_t y = 0; y < n_y; ++y) {
        const Sensor& s = net.sensors[y];
        scale[y] = S(1.0) + prepared->sum(s.scale);
        offset[y] = prepared->sum(s.offset);
        delay[y] = prepared->sum(s.delay);
        flexibility[y] = prepared->sum(s.flexibility);
        travel_offset[y] = prepared->sum(s.travel.offset);
      }
    }
    Pass<S>& pass = *prepared;
    const std::size_t knots = at(request.knots) * n_q;
    const std::span<const double> unknown = request.unknown.subspan(g * knots, knots);
    // What acts at a time [samples].
    const auto set = [&](double t) {
      pass.set_input(u, t);
      if (knots > 0) {
        pass.set_unknown(unknown, (t - segment.first) / segment.steps);
      }
    };
    std::copy_n(starts.begin() + static_cast<std::ptrdiff_t>(g * n), n, x.begin());
    const int steps = segment.steps * net.substeps;
    seen.clear();
    bent.clear();
    const auto note = [&](const S* rate, bool sample) {
      for (std::size_t y = 0; y < n_y; ++y) {
        const Sensor& s = net.sensors[y];
        seen.push_back(pass.moved(s.travel, travel_offset[y], x.data(), rate));
        if (sample) {
          bent.push_back(s.element < 0 ? S(0.0) : pass.forces()[at(s.element)]);
        }
      }
      if (sample && request.with_forces) {
        for (const S& f : pass.forces()) {
          out.forces.push_back(value(f));
        }
      }
    };
    for (int step = 0; step < steps; ++step) {
      const double t = segment.first + static_cast<double>(step) / net.substeps;
      const double dt = 1.0 / net.substeps;
      set(t);
      pass.rates(x.data(), k1.data());
      note(k1.data(), step % net.substeps == 0);
      const auto advance = [&](double factor, const std::vector<S>& k) {
        for (std::size_t i = 0; i < n; ++i) {
          stage[i] = x[i];
          add(stage[i], factor, k[i]);
        }
      };
      advance(0.5 * h, k1);
      set(t + 0.5 * dt);
      pass.rates(stage.data(), k2.data());
      advance(0.5 * h, k2);
      pass.rates(stage.data(), k3.data());
      advance(h, k3);
      set(t + dt);
      pass.rates(stage.data(), k4.data());
      for (std::size_t i = 0; i < n; ++i) {
        add(x[i], h / 6.0, k1[i]);
        add(x[i], h / 3.0, k2[i]);
        add(x[i], h / 3.0, k3[i]);
        add(x[i], h / 6.0, k4[i]);
      }
    }
    set(segment.first + segment.steps);
    pass.rates(x.data(), k1.data());
    note(k1.data(), true);
    for (std::size_t i = 0; i < n; ++i) {
      out.ends[g * n + i] = value(x[i]);
      copy_slopes(x[i], out.d_ends.data() + (g * n + i) * at(out.columns) + at(columns.first),
                  columns.count);
    }
    for (int k = 0; k <= segment.steps; ++k, ++row) {
      for (std::size_t y = 0; y < n_y; ++y) {
        // A delayed sensor looks back by less than a step or by many: cubic Hermite inside the
        // segment, a straight line outside.
        const double place = k * net.substeps - value(delay[y]) / h;
        const int cell = floor_within(place, 0, steps - 1);
        const Moved<S>& a = seen[at(cell) * n_y + y];
        const Moved<S>& b = seen[at(cell + 1) * n_y + y];
        S s = chain(delay[y], place - cell, -1.0 / h);
        S d;
        if (place < 0.0) {
          // Quadratic back from the start: rate and its change over the first step.
          const S bend = (b.rate - a.rate) * s * S(0.5);
          d = a.d + S(h) * (s * (a.rate + bend));
        } else if (place > steps) {
          const S over = s - S(1.0);
          const S bend = (b.rate - a.rate) * over * S(0.5);
          d = b.d + S(h) * (over * (b.rate + bend));
        } else {
          const S rest = S(1.0) - s;
          const S s2 = s * s;
          const S r2 = rest * rest;
          d = (S(1.0) + s + s) * r2 * a.d + (S(1.0) + rest + rest) * s2 * b.d +
              S(h) * (s * r2 * a.rate - rest * s2 * b.rate);
        }
        const S result = scale[y] * d + offset[y] + flexibility[y] * bent[at(k) * n_y + y];
        out.outputs[row * n_y + y] = value(result);
        copy_slopes(result,
                    out.d_outputs.data() + (row * n_y + y) * at(out.columns) + at(columns.first),
                    columns.count);
      }
    }
  }
}

template <int W>
void run_duals(const Network& net, const Request& request, const Columns& columns, Batch& out) {
  const int n_p = static_cast<int>(request.wanted.size());
  const std::size_t n = at(net.states());
  const std::size_t width = at(net.parameters);
  std::vector<std::vector<Dual<W>>> rows;
  for (std::size_t r = 0; r < request.parameters.size() / width; ++r) {
    const auto row = request.parameters.subspan(r * width, width);
    rows.emplace_back(row.begin(), row.end());
  }
  std::vector<Dual<W>> x(request.starts.begin(), request.starts.end());
  for (int c = 0; c < columns.count; ++c) {
    const int column = columns.first + c;
    if (column < n_p) {
      for (auto& row : rows) {
        row[at(request.wanted[at(column)])].d[at(c)] = 1.0;
      }
    } else {
      const int state = request.wanted_states[at(column - n_p)];
      for (std::size_t g = 0; g < request.segments.size(); ++g) {
        x[g * n + at(state)].d[at(c)] = 1.0;
      }
    }
  }
  run_pass(net, request, rows, x, columns, out);
}

#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) && \
    !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
// The whole pass is inlined into each clone, so that its loops take the clone's vectors.
#define FELTMB_FLAT __attribute__((flatten, target_clones("arch=haswell", "default")))
#else
#define FELTMB_FLAT
#endif

FELTMB_FLAT void run_20(const Network& n, const Request& q, const Columns& c, Batch& out) {
  run_duals<20>(n, q, c, out);
}
constexpr int kWidest = 28;
FELTMB_FLAT void run_28(const Network& n, const Request& q, const Columns& c, Batch& out) {
  run_duals<kWidest>(n, q, c, out);
}

void check(const Network& net, const Request& q) {
  const std::size_t n = at(net.states());
  const std::size_t width = at(net.parameters);
  if (width == 0 || q.parameters.empty() || q.parameters.size() % width != 0) {
    throw InvalidParameter(format("lumped network: %zu parameter values, expected rows of %zu",
                                  q.parameters.size(), width));
  }
  if (q.starts.size() != q.segments.size() * n) {
    throw InvalidParameter(format("lumped network: %zu start values, expected %zu segments x %zu",
                                  q.starts.size(), q.segments.size(), n));
  }
  const std::size_t knots = q.segments.size() * net.masses.size() * at(q.knots);
  if (q.knots < 0 || q.unknown.size() != knots) {
    throw InvalidParameter(format("lumped network: %zu values of unknown forces, expected %zu",
                                  q.unknown.size(), knots));
  }
  for (const Segment& s : q.segments) {
    if (s.input < 0 || at(s.input) >= q.inputs.size() || q.inputs[at(s.input)].empty() ||
        s.steps < 1 || s.row < 0 || at(s.row) >= q.parameters.size() / width) {
      throw InvalidParameter("lumped network: a segment needs an input record, a row and a step");
    }
  }
  for (const int w : q.wanted) {
    if (w < 0 || w >= net.parameters) {
      throw InvalidParameter(format("lumped network: no parameter %d of %d", w, net.parameters));
    }
  }
  for (const int w : q.wanted_states) {
    if (w < 0 || w >= net.states()) {
      throw InvalidParameter(format("lumped network: no state %d of %d", w, net.states()));
    }
  }
}

}  // namespace

Batch simulate(const Network& net, const Request& request) {
  check(net, request);
  const std::size_t n = at(net.states());
  std::size_t samples = 0;
  for (const Segment& s : request.segments) {
    samples += at(s.steps) + 1;
  }
  Batch out;
  out.columns = static_cast<int>(request.wanted.size() + request.wanted_states.size());
  out.outputs.resize(samples * net.sensors.size());
  out.ends.resize(request.segments.size() * n);
  out.d_outputs.resize(out.outputs.size() * at(out.columns));
  out.d_ends.resize(out.ends.size() * at(out.columns));
  if (out.columns == 0) {
    const std::size_t width = at(net.parameters);
    std::vector<std::vector<double>> rows;
    for (std::size_t r = 0; r < request.parameters.size() / width; ++r) {
      const auto row = request.parameters.subspan(r * width, width);
      rows.emplace_back(row.begin(), row.end());
    }
    run_pass<double>(net, request, rows, {request.starts.begin(), request.starts.end()}, {0, 0},
                     out);
    return out;
  }
  // The widest whose numbers stay in the nearest cache; wider ones take longer for each column.
  Request part = request;
  for (int first = 0; first < out.columns;) {
    const int left = out.columns - first;
    const Columns columns{first, std::min(left, kWidest)};
    part.with_forces = request.with_forces && first == 0;
    (left <= 20 ? run_20 : run_28)(net, part, columns, out);
    first += columns.count;
  }
  return out;
}

}  // namespace feltmb::lumped
