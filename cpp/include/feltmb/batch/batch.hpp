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
  InputSignal input;
  SimulationOptions options;
  SimulationState start;  ///< empty y: the rest pose
  std::vector<Monitor> monitors;
};

/// Returns the next stroke in its argument; false when there are no more. Called from one thread at
/// a time.
using BatchSource = std::function<bool(BatchStroke&)>;

/// Gets the outcome of stroke `index`. `failure` is empty, or the reason why the stroke could not
/// start. Returning false stops the batch.
using BatchSink =
    std::function<bool(std::size_t index, RunResult&& result, const std::string& failure)>;

struct BatchOptions {
  std::size_t threads = 0;  ///< 0: all cores
  /// True: the sink is called in the order of the strokes, by one thread at a time. False: each
  /// worker calls it as soon as its stroke is finished, so that calls may overlap.
  bool ordered = true;
  std::shared_ptr<const std::atomic<bool>>
      stop;  ///< null, or a flag: when any thread sets it, the batch ends
};

/// Simulates the strokes of `source` and passes each outcome to the sink. At most four outcomes per
/// thread are in memory; faster workers wait. Outcomes do not depend on the number of threads. A
/// sink or source that throws stops the batch; its exception is thrown again here.
/// @returns the number of outcomes passed to the sink
std::size_t simulate_many(const BatchSource& source, const BatchSink& sink,
                          const BatchOptions& options = {});

}  // namespace feltmb
