/// Many strokes in one call, on threads.
#pragma once

#include <cstddef>
#include <functional>
#include <memory>
#include <vector>

#include "feltmb/model/simulation.hpp"

namespace feltmb {

/// One stroke of a batch. Mechanisms are immutable and may be shared between strokes.
struct BatchStroke {
  std::shared_ptr<const Mechanism> mechanism;
  FingerInput input;
  SimulationOptions options;
  SimulationState start;  ///< y empty: the rest pose
  std::vector<Monitor> monitors;
};

/// Takes the next stroke; returns false when there are no more. Called from one thread at a time.
using BatchSource = std::function<bool(BatchStroke&)>;

/// Takes the outcome of stroke `index`: `failure` is empty, or why it could not even begin. Called
/// from one thread at a time, in the order of the strokes. Returning false stops the batch.
using BatchSink =
    std::function<bool(std::size_t index, RunResult&& result, const std::string& failure)>;

/// Simulates strokes as long as `source` gives some, on `threads` (0: all cores), and hands each
/// outcome on in order. No more than four outcomes a thread are in memory, however many strokes
/// there are: workers that run ahead wait. Outcomes do not depend on the number of threads. A sink
/// or source that throws stops the batch; its exception is thrown again here.
/// @returns the number of outcomes handed on
std::size_t simulate_many(const BatchSource& source, const BatchSink& sink,
                          std::size_t threads = 0);

}  // namespace feltmb
