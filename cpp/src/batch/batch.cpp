#include "feltmb/batch/batch.hpp"

#include <atomic>
#include <condition_variable>
#include <exception>
#include <map>
#include <mutex>
#include <optional>
#include <thread>

#include "feltmb/numeric/parallel.hpp"

namespace feltmb {
namespace {

struct Outcome {
  RunResult result;
  std::string failure;
};

/// What the workers share. One lock guards all of it; a stroke takes a thousand times longer than
/// what is done under it.
class Batch {
 public:
  Batch(const BatchSource& source, const BatchSink& sink, const BatchOptions& options,
        std::size_t threads)
      : source_(source),
        sink_(sink),
        most_(4 * threads),
        ordered_(options.ordered),
        told_(options.stop) {}

  void work() {
    BatchStroke stroke;
    while (const std::optional<std::size_t> index = take(stroke)) {
      Outcome outcome;
      try {
        outcome.result = simulate(stroke.mechanism, stroke.input, stroke.options, stroke.start,
                                  stroke.monitors, [this](double) { return !stopped(); });
      } catch (const Error& error) {
        outcome.result.code = error.code();
        outcome.failure = error.what();
      } catch (const std::exception& error) {
        outcome.failure = error.what();
        if (outcome.failure.empty()) outcome.failure = "the stroke could not begin";
      }
      if (ordered_) {
        give(*index, std::move(outcome));
      } else {
        give_now(*index, std::move(outcome));
      }
    }
  }

  std::size_t finish() const {
    if (thrown_) std::rethrow_exception(thrown_);
    return given_;
  }

 private:
  std::optional<std::size_t> take(BatchStroke& stroke) {
    std::unique_lock<std::mutex> lock(guard_);
    room_.wait(lock, [this] { return stopped_ || ended_ || next_ < given_ + most_; });
    if (stopped() || ended_) return std::nullopt;
    try {
      if (source_(stroke)) return next_++;
      ended_ = true;
    } catch (...) {
      stop(std::current_exception());
    }
    room_.notify_all();
    return std::nullopt;
  }

  void give(std::size_t index, Outcome&& outcome) {
    const std::lock_guard<std::mutex> lock(guard_);
    waiting_.emplace(index, std::move(outcome));
    // Whoever brings the outcome that all wait for hands on what lies ready behind it.
    while (!stopped_ && !waiting_.empty() && waiting_.begin()->first == given_) {
      auto node = waiting_.extract(waiting_.begin());
      try {
        if (!sink_(node.key(), std::move(node.mapped().result), node.mapped().failure)) {
          stop(nullptr);
        }
      } catch (...) {
        stop(std::current_exception());
      }
      ++given_;
    }
    room_.notify_all();
  }

  /// The lock is not held meanwhile: others take their next stroke.
  void give_now(std::size_t index, Outcome&& outcome) {
    std::exception_ptr thrown;
    bool go_on = false;
    try {
      go_on = stopped_ || sink_(index, std::move(outcome.result), outcome.failure);
    } catch (...) {
      thrown = std::current_exception();
    }
    const std::lock_guard<std::mutex> lock(guard_);
    if (!go_on) stop(std::move(thrown));
    ++given_;
    room_.notify_all();
  }

  bool stopped() const { return stopped_.load() || (told_ && told_->load()); }

  void stop(std::exception_ptr why) {
    if (!thrown_) thrown_ = std::move(why);
    stopped_ = true;
  }

  const BatchSource& source_;
  const BatchSink& sink_;
  std::size_t most_;
  bool ordered_;
  std::shared_ptr<const std::atomic<bool>> told_;
  std::mutex guard_;
  std::condition_variable room_;
  std::map<std::size_t, Outcome> waiting_;
  std::size_t next_ = 0;
  std::size_t given_ = 0;
  bool ended_ = false;
  std::atomic<bool> stopped_{false};
  std::exception_ptr thrown_;
};

}  // namespace

std::size_t simulate_many(const BatchSource& source, const BatchSink& sink,
                          const BatchOptions& options) {
  const std::size_t threads = resolve_threads(options.threads);
  Batch batch(source, sink, options, threads);
  parallel_for(threads, threads, [&](std::size_t, std::size_t) { batch.work(); });
  return batch.finish();
}

}  // namespace feltmb
