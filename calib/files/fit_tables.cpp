#include "calib/files/fit_tables.hpp"

namespace taut {

void read_head(TableReader& root, Experiment& experiment) {
  experiment.title = root.text("title");
  root.text("data");
  experiment.simulated = root.choice("data", {"measured", "simulated"}) == "simulated";
}

void read_free(TableReader& fit, Experiment& experiment) {
  for (auto& [id, free] : fit.named_tables("free")) {
    experiment.free.push_back(
        {id, free.optional_given("start"), free.optional_given("lower"), free.optional_given("upper")});
    free.finish();
  }
}

void read_references(TableReader& fit, Experiment& experiment) {
  for (TableReader& reference : fit.tables("reference")) {
    ReferenceValue value;
    value.parameter = reference.text("parameter");
    if (!reference.has("value")) reference.fail("", "'value' is missing; add the published value with its unit");
    value.value = *reference.optional_given("value");
    value.source = reference.text("source");
    reference.finish();
    experiment.references.push_back(value);
  }
}

}  // namespace taut
