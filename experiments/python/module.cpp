#include <dlfcn.h>
#include <pybind11/pybind11.h>

#include <chrono>
#include <exception>
#include <mutex>
#include <thread>
#include <utility>

#include "experiments/cli/version.hpp"
#include "experiments/python/compute.hpp"
#include "sim/core/error.hpp"
#include "sim/solve/cholesky.hpp"

namespace taut {
namespace {

namespace py = pybind11;

/// One BLAS thread while anything is computed, as the command has it, so that numbers are the same; NumPy, whose BLAS
/// may be the same library, has its threads back afterwards.
class OneBlasThread {
 public:
  OneBlasThread() {
    const std::lock_guard lock(mutex_);
    if (computing_++ > 0) return;
    if (const auto threads = reinterpret_cast<int (*)()>(dlsym(RTLD_DEFAULT, "openblas_get_num_threads")))
      before_ = threads();
    use_one_blas_thread();
  }
  ~OneBlasThread() {
    const std::lock_guard lock(mutex_);
    if (--computing_ > 0 || before_ <= 1) return;
    if (const auto set = reinterpret_cast<void (*)(int)>(dlsym(RTLD_DEFAULT, "openblas_set_num_threads"))) set(before_);
  }
  OneBlasThread(const OneBlasThread&) = delete;
  OneBlasThread& operator=(const OneBlasThread&) = delete;

 private:
  static inline std::mutex mutex_;
  static inline int computing_ = 0, before_ = 0;
};

/// The file that this code was loaded from.
std::string module_file() {
  Dl_info found{};
  dladdr(reinterpret_cast<const void*>(&this_module), &found);
  return found.dli_fname == nullptr ? Program().file : found.dli_fname;
}

}  // namespace

Computation::Computation(py::object progress, std::atomic<bool>& stop) : progress_(std::move(progress)), stop_(stop) {
  stop_ = false;
}

void Computation::run(const std::function<void()>& work) {
  const OneBlasThread blas;
  std::exception_ptr error;
  std::thread worker([&] {
    try {
      work();
    } catch (...) {
      error = std::current_exception();
    }
    const std::lock_guard lock(mutex_);
    done_ = true;
    changed_.notify_all();
  });
  {
    const py::gil_scoped_release released;
    constexpr std::chrono::milliseconds often(50);
    for (bool done = false; !done;) {
      {
        std::unique_lock lock(mutex_);
        done = changed_.wait_for(lock, often, [&] { return done_; });
      }
      const py::gil_scoped_acquire acquired;
      listen();
    }
    worker.join();
  }
  if (error && !raised_) std::rethrow_exception(error);
}

/// Signals and progress; whatever Python raises ends the work.
void Computation::listen() {
  try {
    if (PyErr_CheckSignals() != 0) throw py::error_already_set();
    tell();
  } catch (py::error_already_set& raised) {
    if (!raised_) raised_.emplace(raised);
    stop_ = true;
  }
}

void Computation::tell() {
  std::vector<std::string> lines;
  {
    const std::lock_guard lock(mutex_);
    lines.swap(said_);
    if (shown_) lines.push_back(*std::exchange(shown_, std::nullopt));
  }
  if (progress_.is_none() || raised_) return;
  for (const std::string& line : lines) progress_(text(line));
}

void Computation::raise(const py::object& result) {
  if (!raised_) return;
  py::object(raised_->value()).attr("result") = result;
  throw py::error_already_set(*raised_);
}

void Computation::say(const std::string& line) {
  const std::lock_guard lock(mutex_);
  said_.push_back(line);
}

void Computation::show(const std::string& line) {
  const std::lock_guard lock(mutex_);
  shown_ = line;
}

py::str text(const std::string& bytes) {
  PyObject* decoded = PyUnicode_DecodeUTF8(bytes.data(), static_cast<Py_ssize_t>(bytes.size()), "surrogateescape");
  if (decoded == nullptr) throw py::error_already_set();
  return py::reinterpret_steal<py::str>(decoded);
}

py::list texts(const std::vector<std::string>& all) {
  py::list list;
  for (const std::string& one : all) list.append(text(one));
  return list;
}

Program this_module(const std::string& called) {
  return {version(), commit(), called, module_file()};
}

}  // namespace taut

PYBIND11_MODULE(_taut, module) {
  namespace py = pybind11;
  module.doc() = "What of the package taut is compiled: see taut.Experiment, taut.simulate and taut.InverseKinematics.";
  module.attr("version") = taut::version();
  module.attr("commit") = taut::commit();
  py::register_exception_translator([](std::exception_ptr thrown) {
    try {
      std::rethrow_exception(thrown);
    } catch (const taut::InputError& error) {
      const py::object type = py::module_::import("taut.errors").attr("InputError");
      PyErr_SetObject(type.ptr(), taut::text(error.what()).ptr());
    }
  });
  taut::bind_experiments(module);
  taut::bind_simulations(module);
}
