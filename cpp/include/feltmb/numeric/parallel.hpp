/// Static division of a loop among threads.
#pragma once

#include <algorithm>
#include <atomic>
#include <cstddef>
#include <exception>
#include <functional>
#include <mutex>
#include <thread>
#include <vector>

namespace feltmb {

/// Largest number of threads per core: more threads gain nothing and need memory.
inline constexpr std::size_t kThreadsPerCore = 4;

/// Number of threads to use: `requested` but at most kThreadsPerCore a core, or every core when it
/// is 0; never less than 1.
inline std::size_t resolve_threads(std::size_t requested) {
  const std::size_t cores = std::max<std::size_t>(1, std::thread::hardware_concurrency());
  return requested == 0 ? cores : std::min(requested, kThreadsPerCore * cores);
}

/// Starts work(part) for the parts 1 to `count` - 1 on separate threads, in this order; returns
/// fewer threads if the system cannot start more.
template <class Work>
std::vector<std::thread> start_threads(std::size_t count, const Work& work) {
  std::vector<std::thread> pool;
  pool.reserve(count);
  try {
    for (std::size_t part = 1; part < count; ++part) pool.emplace_back(work, part);
  } catch (const std::exception&) {  // std::system_error, std::bad_alloc
  }
  return pool;
}

/// Calls body(begin, end) on disjoint parts of [0, n). Results must not depend on the division
/// (write to separate places; add up afterwards in index order) so that they are the same for
/// every thread count. The first exception is thrown again in the caller.
template <class Body>
void parallel_for(std::size_t n, std::size_t threads, Body&& body) {
  threads = std::min(resolve_threads(threads), std::max<std::size_t>(1, n));
  if (threads == 1) {
    if (n > 0) body(std::size_t{0}, n);
    return;
  }
  std::exception_ptr failure;
  std::mutex guard;
  const auto run = [&](std::size_t part) {
    try {
      body(n * part / threads, n * (part + 1) / threads);
    } catch (...) {
      const std::lock_guard<std::mutex> lock(guard);
      if (!failure) failure = std::current_exception();
    }
  };
  std::vector<std::thread> pool = start_threads(threads, run);
  run(0);
  for (std::size_t part = pool.size() + 1; part < threads; ++part) run(part);
  for (std::thread& thread : pool) thread.join();
  if (failure) std::rethrow_exception(failure);
}

/// Threads kept alive for loops that are repeated many thousand times.
class ThreadTeam {
 public:
  /// @param threads  0: all cores
  explicit ThreadTeam(std::size_t threads)
      : workers_(start_threads(resolve_threads(threads), [this](std::size_t part) { work(part); })),
        size_(workers_.size() + 1) {}
  ~ThreadTeam() {
    stop_ = true;
    generation_.fetch_add(1);
    generation_.notify_all();
    for (std::thread& worker : workers_) worker.join();
  }
  ThreadTeam(const ThreadTeam&) = delete;
  ThreadTeam& operator=(const ThreadTeam&) = delete;

  [[nodiscard]] std::size_t size() const { return size_; }

  /// body(begin, end) on disjoint parts of [0, n); body must not throw. Same rule as parallel_for.
  template <class Body>
  void run(std::size_t n, Body&& body) {
    if (size_ == 1 || n < 2) {
      if (n > 0) body(std::size_t{0}, n);
      return;
    }
    task_ = [&body, n, this](std::size_t part) {
      const std::size_t begin = n * part / size_;
      const std::size_t end = n * (part + 1) / size_;
      if (begin < end) body(begin, end);
    };
    pending_.store(size_ - 1);
    generation_.fetch_add(1);
    generation_.notify_all();
    task_(0);
    // The parts end within microseconds of each other: wait actively for a while before sleeping.
    for (int spin = 0; spin < kSpins && pending_.load() > 0; ++spin) {
    }
    for (std::size_t left = pending_.load(); left > 0; left = pending_.load()) {
      pending_.wait(left);
    }
  }

 private:
  void work(std::size_t part) {
    std::size_t seen = 0;
    while (true) {
      for (int spin = 0; spin < kSpins && generation_.load() == seen; ++spin) {
      }
      generation_.wait(seen);
      const std::size_t now = generation_.load();
      if (now == seen) continue;
      seen = now;
      if (stop_) return;
      task_(part);
      if (pending_.fetch_sub(1) == 1) pending_.notify_one();
    }
  }
  static constexpr int kSpins = 500;
  std::function<void(std::size_t)> task_;
  std::atomic<std::size_t> generation_{0};
  std::atomic<std::size_t> pending_{0};
  std::atomic<bool> stop_{false};
  std::vector<std::thread> workers_;  // after all that they look at while they wait
  std::size_t size_;
};

}  // namespace feltmb
