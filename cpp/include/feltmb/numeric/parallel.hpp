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

/// Number of threads to use: `requested`, or every core when it is 0; never less than 1.
inline std::size_t resolve_threads(std::size_t requested) {
  if (requested > 0) return requested;
  return std::max<std::size_t>(1, std::thread::hardware_concurrency());
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
  std::vector<std::thread> pool;
  pool.reserve(threads - 1);
  const auto run = [&](std::size_t part) {
    try {
      body(n * part / threads, n * (part + 1) / threads);
    } catch (...) {
      const std::lock_guard<std::mutex> lock(guard);
      if (!failure) failure = std::current_exception();
    }
  };
  for (std::size_t part = 1; part < threads; ++part) pool.emplace_back(run, part);
  run(0);
  for (std::thread& thread : pool) thread.join();
  if (failure) std::rethrow_exception(failure);
}

/// Threads kept alive for loops that are repeated many thousand times.
class ThreadTeam {
 public:
  /// @param threads  0: all cores
  explicit ThreadTeam(std::size_t threads) : size_(resolve_threads(threads)) {
    for (std::size_t part = 1; part < size_; ++part) {
      workers_.emplace_back([this, part] { work(part); });
    }
  }
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
    // Parts end within microseconds of each other: look a while before sleeping.
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
  std::size_t size_;
  std::function<void(std::size_t)> task_;
  std::atomic<std::size_t> generation_{0};
  std::atomic<std::size_t> pending_{0};
  std::atomic<bool> stop_{false};
  std::vector<std::thread> workers_;
};

}  // namespace feltmb
