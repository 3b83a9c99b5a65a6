#include <benchmark/benchmark.h>
#include <fmt/format.h>

#include <filesystem>
#include <limits>

#include "sim/core/stopwatch.hpp"
#include "tests/support/virtual_crew.hpp"

// What sharing a study costs: the process that hands settings out, with workers that cost nothing (so many tasks a
// second are where it saturates; tasks of a second each keep as many workers busy), and the store of members of a
// bench with four parameters and 64 rows.
namespace taut::test {
namespace {

std::string store_path() {
  return (std::filesystem::temp_directory_path() / "taut_crew_bench.csv").string();
}

void handing_out(benchmark::State& state) {
  constexpr size_t tasks = 100'000;
  Study study;
  study.columns = {"fingerprint", "number", "x"};
  for (size_t i = 0; i < tasks; ++i) study.settings.push_back({{std::to_string(i)}, "", 1});
  size_t taken = 0;
  study.take = [&](size_t, const Cells&) { return ++taken > 0; };
  for (auto _ : state) {
    VirtualCrew crew(static_cast<int>(state.range(0)));
    StudyOptions options{std::numeric_limits<double>::infinity(), store_path(), "f", nullptr, {}};
    options.messages = &crew;
    run_study(study, options);
    state.counters["ideal_share"] = tasks / static_cast<double>(state.range(0)) / crew.now;
  }
  state.counters["tasks_per_s"] =
      benchmark::Counter(static_cast<double>(tasks * state.iterations()), benchmark::Counter::kIsRate);
}
BENCHMARK(handing_out)->Arg(1)->Arg(10)->Arg(100)->Arg(1000)->Arg(10000)->Unit(benchmark::kMillisecond);

void reading_a_store(benchmark::State& state) {
  constexpr int members = 5000;
  const Cells columns{"fingerprint", "seed",        "number", "status",   "log_weight",
                      "chi_squared", "evaluations", "values", "predicted"};
  std::string numbers;
  for (int i = 0; i < 64; ++i) numbers += " 0.0035227851570001234";
  std::filesystem::remove(store_path());
  const Stopwatch watch;
  {
    StudyStore store(store_path(), columns, 2, "12345678-12345678-12345678");
    for (int i = 0; i < members; ++i)
      store.add({"1", std::to_string(i)},
                {"ok", "-0.0123456789", "45.912345678", "4", "61152.123 3.2e9 17080.1 2.9e-4", numbers});
  }
  state.counters["seconds_to_add_1e5"] = 1e5 / members * watch.seconds();
  for (auto _ : state) {
    const StudyStore store(store_path(), columns, 2, "12345678-12345678-12345678");
    benchmark::DoNotOptimize(store.find({"1", "5"}));
  }
  state.counters["MB_of_1e5"] = 1e-6 * 1e5 / members * static_cast<double>(std::filesystem::file_size(store_path()));
  std::filesystem::remove(store_path());
}
BENCHMARK(reading_a_store)->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace taut::test

BENCHMARK_MAIN();
