/// Static division of a loop among threads.
#pragma once

#include <algorithm>
#include <cstddef>
#include <exception>
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

}  // namespace feltmb
