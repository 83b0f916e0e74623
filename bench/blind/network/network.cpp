#include "network.hpp"

#include <cstddef>
#include <initializer_list>

#include "feltmb/core/error.hpp"

namespace feltmb::lumped {
namespace {

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
    if (e.kind == Kind::friction && !e.b.empty() && e.c.empty()) {
      throw InvalidParameter(
          "lumped network: dry friction needs the speed over which it turns (sliding_speed)");
    }
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

}  // namespace feltmb::lumped
