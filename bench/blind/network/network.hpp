/// Network of lumped masses joined by elements, with exact parameter sensitivities.
///
/// A small generic mechanism: coordinates q_i with masses, elements (contact, spring, friction,
/// drive) along linear combinations of coordinates, hidden states (lag, vibration mode) fed by
/// element forces, sensors with scale, offset and delay. Everything is a function of one parameter
/// vector. Fixed-step RK4; the sensitivities are those of the discrete scheme itself, so they agree
/// with differences of the result to rounding wherever it has a derivative: it has none by the
/// delay of the input where that puts a stage on a sample, at zero delay say. Made for fits that
/// restart at many windows.
#pragma once

#include <span>
#include <vector>

namespace feltmb::lumped {

/// Sum of factor * parameters[index].
struct Weight {
  int index;
  double factor;
};
using Sum = std::vector<Weight>;

/// A displacement: sum of factor * coordinate, factor * hidden state, an input factor and an
/// offset.
struct Travel {
  std::vector<Weight> coordinates;
  std::vector<Weight> hidden;  ///< hidden displacements (lag states, mode deflections)
  double input = 0.0;          ///< factor of the corrected input
  Sum offset;                  ///< [m]
};

/// Factor 1 / (1 + exp(-travel / width)) on a contact force.
struct Gate {
  Travel travel;
  Sum width;
};

enum class Kind { contact, spring, friction, drive };

/// Force along a travel d. It pushes against d: coordinate i feels -factor_i * force.
///
/// contact   k max(d, 0)^p max(1 + h d', 0) gates
/// spring    k d + c d' + k3 d^3
/// friction  c d' + fc tanh(d' / vs) + c2 d'|d'|
/// drive     -(input), the corrected input pushing along +d; plus a constant
struct Element {
  Kind kind;
  Travel travel;
  std::vector<Gate> gates;
  Sum a, b, c, d;  ///< contact: k, p, h; spring: k, c, k3; friction: c, fc, vs, c2; drive: constant
};

/// Hidden displacement z fed by element forces F = sum gain * force.
///
/// lag   tau z' = F - z                          one state
/// mode  z'' = omega^2 (F - z) - 2 zeta omega z'  two states (z, z')
struct Hidden {
  bool mode;
  std::vector<int> sources;
  Sum gain;     ///< [m/N]
  Sum time;     ///< lag: tau [s]; mode: omega [rad/s]
  Sum damping;  ///< mode: zeta
};

/// y(t) = (1 + scale) * travel(t - delay) + offset + flexibility * force of an element
struct Sensor {
  Travel travel;
  Sum scale, offset, delay, flexibility;
  int element = -1;
};

/// The record of the input is the reading of a sensor, u(t) = (1 + gain) a(t - delay) + offset of
/// the input a that acts, as the outputs are; so a(t) = (u(t + delay) - offset) / (1 + gain).
struct InputCorrection {
  Sum gain, offset, delay;
};

struct Network {
  std::vector<Sum> masses;
  std::vector<Element> elements;
  std::vector<Hidden> hidden;
  std::vector<Sensor> sensors;
  InputCorrection input;
  int parameters = 0;
  double sample_time = 0.0;  ///< [s], of inputs and outputs
  int substeps = 4;          ///< RK4 steps a sample

  /// Coordinates, their rates, then the hidden states in order.
  int states() const;
  void check() const;
};

/// Piece of a record to simulate: samples first, ..., first + steps of the record `input`, with the
/// row `row` of the parameters.
struct Segment {
  int input;
  int first;
  int steps;
  int row;
};

/// Packed results: sample after sample of all segments.
struct Batch {
  std::vector<double> outputs;    ///< (samples, sensors)
  std::vector<double> ends;       ///< (segments, states): state at the last sample
  std::vector<double> forces;     ///< (samples, elements) [N], if asked for
  std::vector<double> d_outputs;  ///< (samples, sensors, columns)
  std::vector<double> d_ends;     ///< (segments, states, columns)
  int columns = 0;                ///< parameters in `wanted`, then `wanted_states`
};

/// What is simulated. All arrays are rows after rows.
struct Request {
  std::span<const double> parameters;               ///< (rows, parameters)
  std::span<const std::span<const double>> inputs;  ///< recorded inputs
  std::span<const Segment> segments;
  std::span<const double> starts;      ///< (segments, states)
  std::span<const int> wanted;         ///< parameters to differentiate by
  std::span<const int> wanted_states;  ///< start states to differentiate by
  bool with_forces = false;
  int knots = 0;                    ///< of the unknown forces; 0: none
  std::span<const double> unknown;  ///< (segments, coordinates, knots) [N], linear between knots
};

/// Simulate segments from their start states.
Batch simulate(const Network& network, const Request& request);

}  // namespace feltmb::lumped
