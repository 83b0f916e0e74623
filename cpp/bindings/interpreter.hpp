/// Python's lock (GIL), left and taken so that threads survive the end of the interpreter.
///
/// A thread that asks an ending interpreter for its lock is ended in the middle by pthread_exit,
/// which the destructors of C++ do not survive: the process aborts. Daemon threads run that long.
/// As Python 3.14 does, such threads are stopped for good instead: from a callback of `atexit` on,
/// only the thread that ends the interpreter gets the lock.
#pragma once

#include <pybind11/pybind11.h>

#include <cstddef>
#include <optional>

namespace feltmb::python {

/// Runs with the lock released. In place of py::gil_scoped_release.
class WithoutInterpreter {
 public:
  WithoutInterpreter() { released_.emplace(); }
  ~WithoutInterpreter();
  WithoutInterpreter(const WithoutInterpreter&) = delete;
  WithoutInterpreter& operator=(const WithoutInterpreter&) = delete;

 private:
  std::optional<pybind11::gil_scoped_release> released_;
};

/// Takes the lock back for a call from the core. In place of py::gil_scoped_acquire.
class WithInterpreter {
 public:
  WithInterpreter();
  ~WithInterpreter();
  WithInterpreter(const WithInterpreter&) = delete;
  WithInterpreter& operator=(const WithInterpreter&) = delete;

 private:
  std::optional<pybind11::gil_scoped_acquire> taken_;
};

/// Whether a callback of the user's asks to go on: only a returned False (Python's or NumPy's)
/// stops; None, which a function without a return gives, does not.
inline bool goes_on(const pybind11::handle& returned) {
  pybind11::detail::make_caster<bool> flag;
  return !flag.load(returned, false) || static_cast<bool>(flag);
}

/// Threads for work that calls Python: one once the interpreter ends, since others would never get
/// the lock.
std::size_t threads_with_interpreter(std::size_t requested);

/// Registers the callback of `atexit`.
void bind_interpreter();

}  // namespace feltmb::python
