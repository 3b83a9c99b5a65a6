#include <fmt/format.h>
#include <pybind11/eigen.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <map>
#include <memory>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "calib/data/files.hpp"
#include "calib/data/run_folder.hpp"
#include "calib/runs/open_bench.hpp"
#include "calib/runs/predict_rows.hpp"
#include "calib/runs/replay.hpp"
#include "calib/runs/run_fit.hpp"
#include "experiments/python/compute.hpp"
#include "reports/fit_run.hpp"
#include "reports/report.hpp"
#include "reports/run_record.hpp"
#include "sim/core/error.hpp"

namespace taut {
namespace {

namespace py = pybind11;

/// A column of numbers, handed over without a copy.
template <class Get>
py::object column(size_t count, Get&& get) {
  Eigen::VectorXd values(static_cast<Eigen::Index>(count));
  for (size_t i = 0; i < count; ++i) values[static_cast<Eigen::Index>(i)] = get(i);
  return py::cast(std::move(values));
}

py::list axes(const std::vector<AxisRecord>& all) {
  py::list list;
  for (const AxisRecord& axis : all) {
    py::dict one;
    one["id"] = text(axis.id);
    one["unit"] = axis.unit;
    one["quantity"] = axis.quantity;
    one["labels"] = texts(axis.labels);
    list.append(one);
  }
  return list;
}

/// What was read and, where `predicted`, what is predicted: columns, in SI.
py::dict columns_of(const RunRecord& record, bool predicted) {
  const std::vector<ReadingRecord>& readings = record.readings;
  const size_t n = readings.size();
  py::dict columns;
  py::list lines, trials, channels, excluded;
  for (const ReadingRecord& reading : readings) {
    lines.append(reading.line);
    trials.append(text(reading.trial));
    channels.append(text(reading.channel));
    excluded.append(reading.excluded);
  }
  py::list controls;
  for (size_t k = 0; k < record.controls.size(); ++k)
    controls.append(column(n, [&](size_t i) { return readings[i].controls[k]; }));
  columns["line"] = lines;
  columns["trial"] = trials;
  columns["channel"] = channels;
  columns["controls"] = controls;
  columns["value"] = column(n, [&](size_t i) { return readings[i].measured; });
  columns["sigma"] = column(n, [&](size_t i) { return readings[i].sigma; });
  columns["excluded"] = excluded;
  if (predicted) columns["predicted"] = column(n, [&](size_t i) { return readings[i].predicted; });
  return columns;
}

py::list parameters_of(const Bench& bench) {
  const ParameterTable& table = bench.protocol().parameters();
  const Params& nominal = bench.protocol().nominal();
  py::list list;
  for (int i = 0; i < table.size(); ++i) {
    const ParameterSpec& spec = table[i];
    py::dict one;
    one["id"] = text(spec.id);
    one["value"] = nominal[i];
    one["unit"] = spec.unit;
    one["meaning"] = text(spec.meaning);
    one["lower"] = spec.lower;
    one["upper"] = spec.upper;
    one["control"] = bench.sets(spec.id);
    list.append(one);
  }
  return list;
}

/// What a bench is, nothing solved.
py::dict description_of(const Bench& bench, const RunRecord& record) {
  py::dict all;
  all["title"] = text(record.title);
  all["simulated"] = record.simulated;
  all["controls"] = axes(record.controls);
  all["channels"] = axes(record.channels);
  all["readings"] = columns_of(record, false);
  all["parameters"] = parameters_of(bench);
  all["remarks"] = texts(record.remarks);
  return all;
}

using Value = std::variant<double, std::string>;

py::dict replay_dict(const Bench& bench, const Replay& replay) {
  const ParameterTable& table = bench.protocol().parameters();
  py::dict all;
  all["controls"] = axes(replay.record.controls);
  all["channels"] = axes(replay.record.channels);
  all["readings"] = columns_of(replay.record, true);
  all["failures"] = texts(replay.prediction.failures);
  all["warnings"] = texts(bench.warnings_after());
  if (replay.with_respect_to.empty()) return all;
  std::vector<std::string> ids;
  for (const int index : replay.with_respect_to) ids.push_back(table[index].id);
  all["with_respect_to"] = texts(ids);
  Eigen::MatrixXd derivatives(static_cast<Eigen::Index>(replay.derivatives.size()),
                              static_cast<Eigen::Index>(ids.size()));
  for (Eigen::Index i = 0; i < derivatives.rows(); ++i) {
    const std::vector<double>& row = replay.derivatives[static_cast<size_t>(i)];
    derivatives.row(i) = Eigen::Map<const Eigen::RowVectorXd>(row.data(), derivatives.cols());
  }
  all["derivatives"] = py::cast(std::move(derivatives));
  py::list stiffness;
  for (const TangentStiffness& one : replay.stiffness)
    stiffness.append(
        py::dict(py::arg("state") = text(one.where), py::arg("load") = text(one.load), py::arg("N_per_m") = one.value));
  all["tangent_stiffness"] = stiffness;
  return all;
}

/// Rows to predict at, all controls in SI: (rows x controls).
std::vector<LoadRow> load_rows(const Eigen::Ref<const Eigen::MatrixXd>& controls) {
  std::vector<LoadRow> rows;
  for (Eigen::Index i = 0; i < controls.rows(); ++i) {
    const Eigen::VectorXd row = controls.row(i);
    rows.push_back({static_cast<int>(i) + 2, {row.begin(), row.end()}});  // as if a header was line 1
  }
  return rows;
}

/// A fit's result with what it predicts from.
class Fitted {
 public:
  /// `written`: it stands in a folder too.
  Fitted(RunRecord record, Experiment experiment, bool written)
      : record_(std::move(record)), experiment_(std::move(experiment)), written_(written) {}

  static Fitted open(const std::string& folder) {
    settle_run_folder(folder);
    RunRecord record = read_run(folder);
    Experiment experiment = experiment_of_run(record, folder);
    Fitted fitted(std::move(record), std::move(experiment), true);
    fitted.folder_ = folder;
    return fitted;
  }

  std::string json() const { return to_json(record_); }
  bool written() const { return written_; }

  /// `rows`: a CSV file, or (rows x controls) in SI.
  py::dict predict(const std::variant<std::string, Eigen::MatrixXd>& rows, bool anyway, int threads,
                   const py::object& progress) {
    std::atomic<bool> stop{false};
    Computation computation(progress, stop);
    std::optional<RowsPrediction> found;
    computation.run([&] {
      refuse_without_result(record_, name(), anyway);
      refuse_changed_inputs();
      const std::unique_ptr<Bench> whole = open_bench(experiment_, {threads, computation.stop()});
      const auto* file = std::get_if<std::string>(&rows);
      const std::unique_ptr<Bench> bench =
          file != nullptr ? whole->at_loads(*file) : whole->at_rows(load_rows(std::get<Eigen::MatrixXd>(rows)));
      computation.say(fmt::format("predicting {} rows with {} unknowns", bench->readings().size(), bench->unknowns()));
      found = predict_rows(record_, *bench);
    });
    computation.raise(py::none());
    return as_dict(*found);
  }

 private:
  std::string name() const { return folder_.empty() ? experiment_.path : folder_; }

  /// Copies in a folder were looked at when it was opened.
  void refuse_changed_inputs() const {
    if (!folder_.empty()) return;
    for (const InputRecord& input : record_.provenance.inputs) {
      if ((input.text ? sha256_of_text(*input.text) : sha256_of(input.path)) != input.sha256)
        throw InputError(fmt::format(
            "{}: is not what it was when it was fitted; fit again, or with `out`, which copies it", input.path));
    }
  }

  py::dict as_dict(const RowsPrediction& found) const {
    const std::vector<PredictedRow>& rows = found.rows;
    const size_t n = rows.size();
    py::dict all;
    py::list lines, channels, equilibria, controls;
    for (const PredictedRow& row : rows) {
      lines.append(row.line);
      channels.append(text(row.channel));
      equilibria.append(row.equilibria);
    }
    for (size_t k = 0; k < record_.controls.size(); ++k)
      controls.append(column(n, [&](size_t i) { return rows[i].controls[k]; }));
    py::dict columns;
    columns["line"] = lines;
    columns["channel"] = channels;
    columns["controls"] = controls;
    columns["predicted"] = column(n, [&](size_t i) { return rows[i].value; });
    columns["standard_error"] = column(n, [&](size_t i) { return rows[i].error; });
    columns["lower95"] = column(n, [&](size_t i) { return rows[i].value - rows[i].curve; });
    columns["upper95"] = column(n, [&](size_t i) { return rows[i].value + rows[i].curve; });
    columns["reading_lower95"] = column(n, [&](size_t i) { return rows[i].value - rows[i].reading; });
    columns["reading_upper95"] = column(n, [&](size_t i) { return rows[i].value + rows[i].reading; });
    columns["equilibria"] = equilibria;
    all["rows"] = columns;
    all["controls"] = axes(record_.controls);
    all["channels"] = axes(record_.channels);
    all["warnings"] = texts(found.warnings);
    all["failures"] = texts(found.failures);
    return all;
  }

  RunRecord record_;
  Experiment experiment_;
  std::string folder_;  ///< that it was read from; "": it was not
  bool written_;
};

/// An experiment as its file, or a text, has it.
class PyExperiment {
 public:
  PyExperiment(const std::string& path, const std::optional<std::string>& toml)
      : experiment_(toml ? read_experiment_text(path, *toml) : read_experiment(path)) {}

  std::string toml() const { return experiment_.text ? *experiment_.text : read_file(experiment_.path); }

  py::dict describe(int threads, const std::string& rows) const {
    std::atomic<bool> stop{false};
    Computation computation(py::none(), stop);
    std::unique_ptr<Bench> bench;
    RunRecord record;
    computation.run([&] {
      bench = open(computation, threads, Readings::may_be_blank, rows);
      record = start_record(*bench);
    });
    computation.raise(py::none());
    return description_of(*bench, record);
  }

  py::dict replay(const std::map<std::string, Value>& set, bool derivatives, const std::string& rows, int threads,
                  const py::object& progress) const {
    std::atomic<bool> stop{false};
    Computation computation(progress, stop);
    std::unique_ptr<Bench> bench;
    std::optional<Replay> replay;
    computation.run([&] {
      bench = open(computation, threads, Readings::may_be_blank, rows);
      Params p = bench->protocol().nominal();
      for (const auto& [id, given] : set)
        std::visit([&, &id = id](const auto& value) { set_parameter(*bench, id, value, id, p); }, given);
      computation.say("replaying " + bench->size_text());
      replay = replay_bench(*bench, p, derivatives);
    });
    computation.raise(py::none());
    return replay_dict(*bench, *replay);
  }

  /// (how it ended, result or None, which stages failed and why there is no report, failures of the start)
  py::tuple fit(const std::string& out, bool variants, bool fresh, const std::string& called, int threads,
                const py::object& progress) const {
    std::atomic<bool> stop{false};
    Computation computation(progress, stop);
    FitJob job{this_module(called), out, variants, fresh, &stop};
    job.say = [&](const std::string& line) { computation.say(line); };
    job.show = [&](const std::string& line) { computation.show(line); };
    FitRun run;
    computation.run([&] { run = fit_bench(*open(computation, threads, Readings::needed, ""), job); });
    const bool kept = run.end == FitEnd::kept, found = kept || run.end == FitEnd::not_replacing;
    const py::list failures = texts(run.record.fit.failures);
    const std::vector<std::string> failed_stages = run.record.failed_stages;
    const py::str end(run.end == FitEnd::start_failed ? "start failed" : "");
    const py::object result =
        found ? py::cast(Fitted(std::move(run.record), experiment_, kept && !out.empty())) : py::none();
    computation.raise(result);
    std::vector<std::string> lost = failed_stages;
    lost.push_back(run.report_failure.empty() ? undrawn_figures() : run.report_failure);
    if (lost.back().empty()) lost.pop_back();
    return py::make_tuple(end, result, texts(lost), failures);
  }

 private:
  std::unique_ptr<Bench> open(const Computation& computation, int threads, Readings readings,
                              const std::string& rows) const {
    return open_bench(experiment_, {threads, computation.stop(), readings, rows});
  }

  Experiment experiment_;
};

}  // namespace

void bind_experiments(py::module_& module) {
  using py::arg;
  py::class_<PyExperiment>(module, "Experiment")
      .def(py::init<const std::string&, const std::optional<std::string>&>(), arg("path"), arg("toml") = py::none())
      .def("toml", [](const PyExperiment& self) { return text(self.toml()); })
      .def("describe", &PyExperiment::describe, arg("threads"), arg("rows"))
      .def("replay", &PyExperiment::replay, arg("set"), arg("derivatives"), arg("rows"), arg("threads"),
           arg("progress"))
      .def("fit", &PyExperiment::fit, arg("out"), arg("variants"), arg("fresh"), arg("called"), arg("threads"),
           arg("progress"));
  py::class_<Fitted>(module, "Fitted")
      .def_static("open", &Fitted::open, arg("folder"))
      .def("json", [](const Fitted& self) { return text(self.json()); })
      .def("written", &Fitted::written)
      .def("predict", &Fitted::predict, arg("rows"), arg("anyway"), arg("threads"), arg("progress"));
}

}  // namespace taut
