#include <algorithm>
#include <array>
#include <cstddef>
#include <optional>
#include <span>
#include <utility>
#include <vector>

#include "dynamics.hpp"
#include "feltmb/core/error.hpp"
#include "feltmb/numeric/floor_within.hpp"
#include "network.hpp"
#include "slopes.hpp"

namespace feltmb::lumped {
namespace {

std::size_t at(int i) { return static_cast<std::size_t>(i); }

/// States of a stage and their derivatives.
struct States {
  std::vector<double> x, slopes;  ///< (n), (n, width)
};

/// A sensor with the numbers of one row of parameters.
struct Instrument {
  Number scale, offset, delay, flexibility, travel;
  bool late = false;  ///< It looks between the steps.
};

/// Simulates segment after segment.
class Run {
 public:
  Run(const Network& net, const Request& request, Batch& out)
      : net_(net),
        request_(request),
        out_(out),
        n_(at(net.states())),
        n_y_(net.sensors.size()),
        columns_(at(out.columns)),
        width_((columns_ + row_block - 1) / row_block * row_block),
        h_(net.sample_time / net.substeps),
        moving_(n_, false) {
    if (columns_ > 0) {
      column_of_.resize(at(net.parameters));
      for (std::size_t c = 0; c < request.wanted.size(); ++c) {
        column_of_[at(request.wanted[c])].push_back(c);
      }
    }
    for (std::size_t i = 0; i < request.starts.size(); ++i) {
      if (request.starts[i] != 0.0) {
        moving_[i % n_] = true;
      }
    }
    for (const int state : request.wanted_states) {
      moving_[at(state)] = true;
    }
    result_.resize(width_);
    seen_.resize(n_y_);
    seen_slopes_.resize(n_y_);
  }

  void segment(std::size_t g) {
    const Segment& segment = request_.segments[g];
    if (!dynamics_ || segment.row != row_) {
      prepare(segment.row);
    }
    start(g);
    const std::span<const double> u = request_.inputs[at(segment.input)];
    const std::size_t knots = at(request_.knots) * net_.masses.size();
    const std::span<const double> unknown = request_.unknown.subspan(g * knots, knots);
    const auto set = [&](double t) {
      dynamics_->set_input(u, t);
      if (knots > 0) {
        dynamics_->set_unknown(unknown, (t - segment.first) / segment.steps);
      }
    };
    const int steps = segment.steps * net_.substeps;
    const double dt = 1.0 / net_.substeps;
    for (int step = 0; step < steps; ++step) {
      const double t = segment.first + static_cast<double>(step) / net_.substeps;
      set(t);
      rates(now_, k1_);
      note(step % net_.substeps == 0);
      advance(second_, 0.5 * h_, now_, k1_);
      set(t + 0.5 * dt);
      rates(second_, k2_);
      advance(third_, 0.5 * h_, second_, k2_);
      rates(third_, k3_);
      advance(fourth_, h_, third_, k3_);
      set(t + dt);
      rates(fourth_, k4_);
      finish();
    }
    set(segment.first + segment.steps);
    rates(now_, k1_);
    note(true);
    end(g);
    for (int k = 0; k <= segment.steps; ++k, ++sample_) {
      for (std::size_t y = 0; y < n_y_; ++y) {
        measure(y, k, steps);
      }
    }
  }

 private:
  double* row(States& s, std::size_t i) { return s.slopes.data() + i * width_; }
  /// Derivatives of the rate of state i, evaluated in the stage `at`.
  const double* rate_row(const States& stage, const States& k, std::size_t i) const {
    const std::size_t j = dynamics_->rate_of(i);
    return (j == i ? k : stage).slopes.data() + j * width_;
  }

  void prepare(int row) {
    row_ = row;
    const std::size_t width = at(net_.parameters);
    dynamics_.emplace(net_, request_.parameters.subspan(at(row) * width, width), column_of_,
                      moving_);
    // What rests with these parameters stays zero.
    for (States* s : {&now_, &second_, &third_, &fourth_, &k1_, &k2_, &k3_, &k4_}) {
      s->x.assign(n_, 0.0);
      s->slopes.assign(n_ * width_, 0.0);
    }
    instruments_.clear();
    for (const Sensor& s : net_.sensors) {
      Instrument x{dynamics_->sum(s.scale), dynamics_->sum(s.offset), dynamics_->sum(s.delay),
                   dynamics_->sum(s.flexibility), dynamics_->sum(s.travel.offset)};
      x.scale.v = 1.0 + x.scale.v;
      x.late = !x.delay.dead();
      instruments_.push_back(std::move(x));
    }
  }

  void start(std::size_t g) {
    std::copy_n(request_.starts.begin() + static_cast<std::ptrdiff_t>(g * n_), n_, now_.x.begin());
    std::fill(now_.slopes.begin(), now_.slopes.end(), 0.0);
    if (columns_ > 0) {
      for (std::size_t c = 0; c < request_.wanted_states.size(); ++c) {
        row(now_, at(request_.wanted_states[c]))[request_.wanted.size() + c] = 1.0;
      }
    }
    for (std::size_t y = 0; y < n_y_; ++y) {
      seen_[y].clear();
      seen_slopes_[y].clear();
    }
    bent_.clear();
    bent_slopes_.clear();
  }

  void rates(States& stage, States& k) {
    dynamics_->rates(stage.x.data(), k.x.data());
    if (columns_ == 0) {
      return;
    }
    for (const std::size_t i : dynamics_->live()) {
      if (dynamics_->rate_of(i) != i) {
        continue;
      }
      terms_.clear();
      const double* slopes = dynamics_->by_states(i);
      for (const std::size_t j : dynamics_->live()) {
        if (slopes[j] != 0.0) {
          terms_.push_back({slopes[j], row(stage, j)});
        }
      }
      double* to = row(k, i);
      combine(to, terms_.data(), terms_.size(), width_);
      for (const Slope& s : dynamics_->by_columns(i)) {
        to[s.index] += s.value;
      }
    }
  }

  /// to = now + factor * k, k evaluated in `stage`.
  void advance(States& to, double factor, States& stage, const States& k) {
    for (std::size_t i = 0; i < n_; ++i) {
      to.x[i] = now_.x[i] + factor * k.x[i];
    }
    if (columns_ == 0) {
      return;
    }
    for (const std::size_t i : dynamics_->live()) {
      const std::array<Term, 2> terms{{{1.0, row(now_, i)}, {factor, rate_row(stage, k, i)}}};
      combine(row(to, i), terms.data(), terms.size(), width_);
    }
  }

  /// One step of the classical Runge-Kutta method.
  void finish() {
    for (std::size_t i = 0; i < n_; ++i) {
      double& x = now_.x[i];
      x += h_ / 6.0 * k1_.x[i];
      x += h_ / 3.0 * k2_.x[i];
      x += h_ / 3.0 * k3_.x[i];
      x += h_ / 6.0 * k4_.x[i];
    }
    if (columns_ == 0) {
      return;
    }
    // The rate of a state stands behind it, so that none is overwritten before it is used.
    for (const std::size_t i : dynamics_->live()) {
      const std::array<Term, 5> terms{{{1.0, row(now_, i)},
                                       {h_ / 6.0, rate_row(now_, k1_, i)},
                                       {h_ / 3.0, rate_row(second_, k2_, i)},
                                       {h_ / 3.0, rate_row(third_, k3_, i)},
                                       {h_ / 6.0, rate_row(fourth_, k4_, i)}}};
      combine(row(now_, i), terms.data(), terms.size(), width_);
    }
  }

  /// What the sensors see in the present state, whose rates are k1.
  void note(bool sample) {
    for (std::size_t y = 0; y < n_y_; ++y) {
      const Sensor& s = net_.sensors[y];
      const Instrument& instrument = instruments_[y];
      if (!sample && !instrument.late) {
        continue;
      }
      seen_[y].push_back(
          dynamics_->moved(s.travel, instrument.travel.v, now_.x.data(), k1_.x.data()));
      if (columns_ > 0) {
        note_slopes(s.travel, instrument, seen_slopes_[y]);
      }
    }
    if (!sample) {
      return;
    }
    for (const Sensor& s : net_.sensors) {
      bent_.push_back(s.element < 0 ? 0.0 : dynamics_->force(at(s.element)));
      if (columns_ > 0) {
        bent_slopes_.resize(bent_slopes_.size() + width_);
        double* to = bent_slopes_.data() + bent_slopes_.size() - width_;
        if (s.element >= 0) {
          gather(dynamics_->force_by_states(at(s.element)),
                 dynamics_->force_by_columns(at(s.element)), to);
        }
      }
    }
    if (request_.with_forces) {
      for (std::size_t e = 0; e < dynamics_->elements(); ++e) {
        out_.forces.push_back(dynamics_->force(e));
      }
    }
  }

  /// Derivatives of displacement and, where it is used, rate.
  void note_slopes(const Travel& travel, const Instrument& instrument, std::vector<double>& to) {
    to.resize(to.size() + (instrument.late ? 2 : 1) * width_);
    double* place = to.data() + to.size() - (instrument.late ? 2 : 1) * width_;
    states_.clear();
    columns_of_.clear();
    dynamics_->append_travel(travel, instrument.travel.d, 1.0, 0.0, states_, columns_of_);
    gather(states_, columns_of_, place);
    if (instrument.late) {
      states_.clear();
      columns_of_.clear();
      dynamics_->append_travel(travel, {}, 0.0, 1.0, states_, columns_of_);
      std::erase_if(states_, [](const Slope& s) { return s.value == 0.0; });
      gather(states_, columns_of_, place + width_);
      // A lag has a rate, though none of its own among the states.
      for (const Weight& w : travel.hidden) {
        const std::size_t j = dynamics_->place(w.index);
        if (!net_.hidden[at(w.index)].mode) {
          const std::array<Term, 2> terms{{{1.0, place + width_}, {w.factor, row(k1_, j)}}};
          combine(place + width_, terms.data(), terms.size(), width_);
        }
      }
    }
  }

  /// Sum over states in the present state and over columns.
  void gather(const Slopes& states, const Slopes& columns, double* to) {
    terms_.clear();
    for (const Slope& s : states) {
      terms_.push_back({s.value, row(now_, s.index)});
    }
    combine(to, terms_.data(), terms_.size(), width_);
    for (const Slope& s : columns) {
      to[s.index] += s.value;
    }
  }

  void end(std::size_t g) {
    for (std::size_t i = 0; i < n_; ++i) {
      out_.ends[g * n_ + i] = now_.x[i];
      std::copy_n(row(now_, i), columns_, out_.d_ends.data() + (g * n_ + i) * columns_);
    }
  }

  /// Sample k of a segment as sensor y shows it.
  void measure(std::size_t y, int k, int steps) {
    const Instrument& x = instruments_[y];
    double d = 0.0;
    double by_share = 0.0;  // of d, by the place between the steps
    terms_.clear();
    if (x.late) {
      // A delayed sensor looks back by less than a step or by many: cubic Hermite inside the
      // segment, a parabola outside.
      const double place = k * net_.substeps - x.delay.v / h_;
      const int cell = floor_within(place, 0, steps - 1);
      const Moved& a = seen_[y][at(cell)];
      const Moved& b = seen_[y][at(cell + 1)];
      const double s = place - cell;
      std::array<double, 4> weights{};  // of the displacement and rate of a, of b
      if (place < 0.0) {
        const double bend = (b.rate - a.rate) * s * 0.5;
        d = a.d + h_ * (s * (a.rate + bend));
        by_share = h_ * (a.rate + s * (b.rate - a.rate));
        weights = {1.0, h_ * (s - 0.5 * s * s), 0.0, h_ * (0.5 * s * s)};
      } else if (place > steps) {
        const double over = s - 1.0;
        const double bend = (b.rate - a.rate) * over * 0.5;
        d = b.d + h_ * (over * (b.rate + bend));
        by_share = h_ * (b.rate + over * (b.rate - a.rate));
        weights = {0.0, -h_ * (0.5 * over * over), 1.0, h_ * (over + 0.5 * over * over)};
      } else {
        const double rest = 1.0 - s;
        const double s2 = s * s;
        const double r2 = rest * rest;
        weights = {(1.0 + s + s) * r2, h_ * (s * r2), (1.0 + rest + rest) * s2, -h_ * (rest * s2)};
        d = weights[0] * a.d + weights[2] * b.d + h_ * (s * r2 * a.rate - rest * s2 * b.rate);
        by_share = 6.0 * s * rest * (b.d - a.d) +
                   h_ * (rest * (rest - s - s) * a.rate - s * (rest + rest - s) * b.rate);
      }
      if (columns_ > 0) {
        const double* slopes = seen_slopes_[y].data() + 2 * at(cell) * width_;
        for (std::size_t i = 0; i < weights.size(); ++i) {
          terms_.push_back({x.scale.v * weights[i], slopes + i * width_});
        }
      }
    } else {
      d = seen_[y][at(k)].d;
      if (columns_ > 0) {
        terms_.push_back({x.scale.v, seen_slopes_[y].data() + at(k) * width_});
      }
    }
    const double bent = bent_[at(k) * n_y_ + y];
    out_.outputs[sample_ * n_y_ + y] = x.scale.v * d + x.offset.v + x.flexibility.v * bent;
    if (columns_ == 0) {
      return;
    }
    terms_.push_back({x.flexibility.v, bent_slopes_.data() + (at(k) * n_y_ + y) * width_});
    combine(result_.data(), terms_.data(), terms_.size(), width_);
    const auto more = [&](double factor, const Slopes& slopes) {
      for (const Slope& s : slopes) {
        result_[s.index] += factor * s.value;
      }
    };
    more(d, x.scale.d);
    more(1.0, x.offset.d);
    more(bent, x.flexibility.d);
    more(-x.scale.v * by_share / h_, x.delay.d);
    std::copy_n(result_.begin(), columns_, out_.d_outputs.data() + (sample_ * n_y_ + y) * columns_);
  }

  const Network& net_;
  const Request& request_;
  Batch& out_;
  std::size_t n_, n_y_, columns_, width_;
  double h_;
  std::vector<bool> moving_;
  std::vector<std::vector<std::size_t>> column_of_;
  std::optional<Dynamics> dynamics_;
  int row_ = -1;
  std::vector<Instrument> instruments_;
  States now_, second_, third_, fourth_;  ///< of the four stages
  States k1_, k2_, k3_, k4_;              ///< their rates
  std::size_t sample_ = 0;
  std::vector<std::vector<Moved>> seen_;  ///< by sensor: every step, or every sample
  std::vector<std::vector<double>> seen_slopes_;
  std::vector<double> bent_, bent_slopes_;  ///< (samples, sensors): force of its element
  std::vector<Term> terms_;
  Slopes states_, columns_of_;
  std::vector<double> result_;
};

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
  Run run(net, request, out);
  for (std::size_t g = 0; g < request.segments.size(); ++g) {
    run.segment(g);
  }
  return out;
}

}  // namespace feltmb::lumped
