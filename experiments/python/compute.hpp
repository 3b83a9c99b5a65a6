#pragma once
#include <pybind11/pybind11.h>

#include <atomic>
#include <condition_variable>
#include <functional>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include "calib/runs/provenance.hpp"

// How the module computes: on a thread of its own, without Python's lock, to be ended by Ctrl-C.
namespace taut {

/// One computation that Python waits for. Its work runs on another thread while other threads of Python go on; the
/// waiting one looks for signals and hands lines of progress to a callable of Python's, or to None.
class Computation {
 public:
  /// `stop` is raised when the work shall end soon; it outlives this, and is lowered here.
  Computation(pybind11::object progress, std::atomic<bool>& stop);

  /// Returns when the work has ended; throws what it threw. What Python raised meanwhile (KeyboardInterrupt, or what
  /// the callable threw) ends the work early and is kept for raise().
  void run(const std::function<void()>& work);
  /// Throws what Python raised, `result` being its attribute "result"; nothing when it did not.
  void raise(const pybind11::object& result);

  const std::atomic<bool>* stop() const { return &stop_; }
  void say(const std::string& line);   ///< a line that stays; of the work's thread
  void show(const std::string& line);  ///< a line that the next one replaces

 private:
  void listen();
  void tell();

  pybind11::object progress_;
  std::atomic<bool>& stop_;
  std::mutex mutex_;
  std::condition_variable changed_;
  std::vector<std::string> said_;
  std::optional<std::string> shown_;
  bool done_ = false;
  std::optional<pybind11::error_already_set> raised_;
};

/// Text for Python; bytes that are not UTF-8 (of paths, say) as os.fsdecode() has them.
pybind11::str text(const std::string& bytes);
pybind11::list texts(const std::vector<std::string>& all);  ///< see text()

/// This module; `called` is what provenance names as its command line.
Program this_module(const std::string& called);

void bind_experiments(pybind11::module_& module);  ///< Experiment, Fitted
void bind_simulations(pybind11::module_& module);  ///< simulate(), InverseKinematics

}  // namespace taut
