#pragma once
#include <memory>
#include <string>
#include <vector>

#include "calib/benches/assumptions.hpp"

namespace taut {

/// One of several specimens in a bench: what it is, and its readings.
struct Specimen {
  std::string label;             ///< "length 60 mm", "specimen A"
  std::string suffix;            ///< of parameters of its own: "A"; of numbers their rank from the smallest: "1"
  Experiment experiment;         ///< with its dimensions, and without others
  Trials trials;                 ///< its readings only
  std::vector<size_t> readings;  ///< their places among all
};

/// The specimens of the readings, in the order of what their columns hold. Throws InputError naming the specimen where
/// its dimensions clash, or where it has parameters of its own and the bench's file does not have it.
std::vector<Specimen> specimens_of(const Experiment& experiment, const Trials& trials);
/// What each specimen has for itself: [fit.free.ID] with `per`, and the suffixes of all specimens of the bench's file.
struct OwnParameters {
  std::vector<std::string> ids, suffixes;
};
/// See OwnParameters.
OwnParameters own_parameters(const Experiment& experiment, const Trials& trials);
/// An experiment whose free parameters with `per` are those of each specimen: "E_foam_A", "E_foam_B".
Experiment with_own_parameters(const Experiment& experiment, const OwnParameters& own);

/// The rows of several specimens as those of one protocol. A parameter is that of all, or each specimen has its own.
///
/// The table: parameters of the model, then those that specimens have for themselves, as ID_SUFFIX (ID itself changes
/// nothing then), then dimensions. What a column sets is not the table's but each specimen's.
class SpecimensProtocol final : public Protocol {
 public:
  /// A specimen's protocol; all have tables of the same ids.
  struct Part {
    Protocol* protocol = nullptr;
    std::unique_ptr<Protocol> owned;  ///< the same where nobody else has it
    std::string label, suffix;        ///< as Specimen has them
  };
  /// `set`: ids that columns set; `dimensions`: how many parameters at the end of the parts' tables are dimensions.
  SpecimensProtocol(std::vector<Part> parts, const OwnParameters& own, const std::vector<std::string>& set,
                    int dimensions);

  const ParameterTable& parameters() const override { return table_; }
  const Params& nominal() const override { return nominal_; }
  int row_count() const override { return rows_; }
  Prediction predict(const Params& p, const std::vector<int>& free) override;
  void forget() override;
  void begin_search() override;
  void end_search() override;
  std::string state() const override;
  void restore(const std::string& state) override;
  std::vector<Alternative> alternatives(const Params& p) override;
  void follow(const Params& at, const std::vector<int>& rows) override;
  int factorisations() const override;

  int first_row(size_t part) const { return first_row_[part]; }  ///< of a part among all rows
  size_t part_of(int row) const;                                 ///< that a row belongs to
  Params of_part(size_t part, const Params& p) const;            ///< in the order of its own table
  /// Places in `free` of those that a part has, and their indices in its table.
  std::pair<std::vector<int>, std::vector<int>> free_of_part(size_t part, const std::vector<int>& free) const;

 private:
  std::vector<Part> parts_;
  std::vector<std::vector<int>> index_;  ///< of each part's parameters, in the table; -1: its own nominal value
  std::vector<int> first_row_;
  ParameterTable table_;
  Params nominal_;
  int rows_ = 0;
};

/// The full model of an experiment, whatever specimens it has, with these dimensions as parameters. Throws InputError
/// as make_static_replay() does.
DimensionedModel full_model(const Experiment& experiment, const Trials& trials,
                            const std::vector<Dimension>& dimensions);

/// The models of `specimens` of an experiment as one, their rows one after the other.
DimensionedModel as_one(const std::vector<Specimen>& specimens, std::vector<DimensionedModel> models,
                        const Experiment& experiment, const OwnParameters& own);

}  // namespace taut
