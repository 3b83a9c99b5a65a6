#pragma once
#include "calib/benches/material_point_bench.hpp"
#include "calib/benches/recordings_bench.hpp"
#include "calib/benches/static_bench.hpp"

namespace taut {

/// The list of kinds of benches; the first is that of files that name none.
inline constexpr const BenchKind* bench_kinds[] = {&static_kind, &recordings_kind, &material_point_kind};

}  // namespace taut
