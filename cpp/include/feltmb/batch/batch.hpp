/// Many strokes in one call, on threads.
#pragma once

#include <atomic>
#include <cstddef>
#include <functional>
#include <memory>
#include <vector>

#include "feltmb/model/simulation.hpp"

namespace feltmb {

/// One stroke of a batch. Mechanisms are immutable and may be shared between strokes.
struct BatchStroke {
  std::shared_ptr<const Mechanism> mechanism;
  Input input;
  SimulationOptions options;
  SimulationState start;  ///< y empty: the rest pose
  std::vector<Monitor> monitors;
};

/// Takes the next stroke; returns false when there are no more. Called from one thread at a time.
using BatchSource = std::function<bool(BatchStroke&)>;

/// Takes the outcome of stroke `index`: `failure` is empty, or why it could not even begin.
/// Returning false stops the batch.
using BatchSink =
    std::function<bool(std::size_t index, RunResult&& result, const std::string& failure)>;

struct BatchOptions {
  std::size_t threads = 0;  ///< 0: all cores
  /// True: the sink is called from one thread at a time, in the order of the strokes. False: by
  /// each worker as soon as its stroke is finished, maybe by several at once.
  bool ordered = true;
  std::shared_ptr<const std::atomic<bool>>
      stop;  ///< set by anyone: ends the batch at once; or none
};

/// Simulates strokes as long as `source` gives some and hands each outcome on. No more than four
/// outcomes a thread are in memory, however many strokes there are: workers that run ahead wait.
/// Outcomes do not depend on the number of threads. A sink or source that throws stops the batch;
/// its exception is thrown again here.
/// @returns the number of outcomes handed on
std::size_t simulate_many(const BatchSource& source, const BatchSink& sink,
                          const BatchOptions& options = {});

}  // namespace feltmb
