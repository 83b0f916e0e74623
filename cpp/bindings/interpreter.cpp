#include "interpreter.hpp"

#include <pthread.h>

#include <atomic>
#include <chrono>
#include <thread>

namespace py = pybind11;

namespace feltmb::python {
namespace {

std::atomic<bool> ending{false};
std::atomic<int> inside{0};  ///< threads that ask for the lock, or hold it in a call from the core
std::thread::id ender;       ///< written before `ending`

/// Before the lock is asked for; never returns to other threads once the interpreter ends.
void enter() {
  ++inside;
  if (!ending || std::this_thread::get_id() == ender) return;
  --inside;
  while (true) std::this_thread::sleep_for(std::chrono::hours(1));
}

/// From here on nobody else enters. Who is inside may finish; a callback that takes longer than a
/// second is left behind.
void end() {
  ender = std::this_thread::get_id();
  ending = true;
  const py::gil_scoped_release release;
  for (int i = 0; i < 1000 && inside > 0; ++i) {
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
}

}  // namespace

WithoutInterpreter::~WithoutInterpreter() {
  enter();
  released_.reset();
  --inside;
}

WithInterpreter::WithInterpreter() {
  enter();
  taken_.emplace();
}

WithInterpreter::~WithInterpreter() {
  taken_.reset();
  --inside;
}

std::size_t threads_with_interpreter(std::size_t requested) { return ending ? 1 : requested; }

void bind_interpreter() {
  py::module_::import("atexit").attr("register")(py::cpp_function(&end));
  // The child of a fork has none of the other threads.
  pthread_atfork(nullptr, nullptr, [] { inside = 0; });
}

}  // namespace feltmb::python
