#include "sim/core/units.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <map>
#include <set>

#include "tests/support/message.hpp"

namespace taut {
namespace {

using test::expect_input_error;
using enum Quantity;

const std::vector<Quantity> kQuantities = {pure,    length,       area, mass,  force,     pressure,
                                           density, acceleration, time, angle, stiffness, line_load};

/// SI values written out by hand, from the definitions in NIST SP 811, Appendix B.
const std::map<Quantity, std::map<std::string, double>> kTable = {
    {pure, {{"1", 1}, {"%", 0.01}}},
    {length, {{"m", 1}, {"mm", 0.001}, {"cm", 0.01}, {"um", 0.000001}, {"km", 1000}, {"in", 0.0254}}},
    {area, {{"m2", 1}, {"mm2", 0.000001}, {"cm2", 0.0001}}},
    {mass, {{"kg", 1}, {"g", 0.001}, {"mg", 0.000001}, {"lb", 0.45359237}, {"oz", 0.028349523125}}},
    {force, {{"N", 1}, {"mN", 0.001}, {"kN", 1000}, {"kgf", 9.80665}, {"gf", 0.00980665}, {"lbf", 4.4482216152605}}},
    {pressure,
     {{"Pa", 1}, {"kPa", 1000}, {"MPa", 1000000}, {"GPa", 1000000000}, {"N/mm2", 1000000}, {"psi", 6894.757293168361}}},
    {density, {{"kg/m3", 1}, {"g/cm3", 1000}}},
    {acceleration, {{"m/s2", 1}, {"mm/s2", 0.001}}},
    {time, {{"s", 1}, {"ms", 0.001}, {"min", 60}}},
    {angle, {{"rad", 1}, {"deg", 0.017453292519943295}}},
    {stiffness, {{"N/m", 1}, {"N/mm", 1000}, {"kN/m", 1000}}},
    {line_load, {{"N/m", 1}, {"N/mm", 1000}}},
};

TEST(Units, EveryFactorAgreesWithTheTable) {
  for (const Quantity quantity : kQuantities) {
    const std::map<std::string, double>& expected = kTable.at(quantity);
    const std::vector<std::string> units = units_of(quantity);
    EXPECT_EQ(std::set<std::string>(units.begin(), units.end()).size(), expected.size()) << name_of(quantity);
    for (const std::string& unit : units) {
      ASSERT_TRUE(expected.contains(unit)) << unit;
      EXPECT_DOUBLE_EQ(unit_factor(unit, quantity, "here"), expected.at(unit)) << unit;
    }
  }
}

TEST(Units, TheSiUnitComesFirst) {
  for (const Quantity quantity : kQuantities) {
    EXPECT_EQ(unit_factor(units_of(quantity).front(), quantity, "here"), 1.0) << name_of(quantity);
  }
}

TEST(Units, QuantitiesHaveDifferentNames) {
  std::set<std::string_view> names;
  for (const Quantity quantity : kQuantities) names.insert(name_of(quantity));
  EXPECT_EQ(names.size(), kQuantities.size());
}

TEST(Units, AnUnknownUnitIsAnsweredWithTheKnownOnesAndTheNearest) {
  expect_input_error(
      [] { unit_factor("kpa", pressure, "foam.E"); },
      {"foam.E: ", "'kpa' is not a unit of pressure", "did you mean 'kPa'?", "Pa, kPa, MPa, GPa, N/mm2, psi"});
  expect_input_error([] { unit_factor("MM", length, "here"); }, {"'MM'", "m, mm, cm"});
  expect_input_error([] { unit_factor("", length, "here"); }, {"'' is not a unit of length"});
}

TEST(Units, AUnitOfAnotherQuantityIsNamedAsSuch) {
  expect_input_error([] { unit_factor("psi", force, "tip"); }, {"'psi' is not a unit of force", "a unit of pressure"});
}

TEST(ParseNumber, AcceptsAWholeFiniteDecimalNumberAndNothingElse) {
  EXPECT_EQ(parse_number("12.5"), 12.5);
  EXPECT_EQ(parse_number("+1.25e1"), 12.5);
  EXPECT_EQ(parse_number("-.5"), -0.5);
  EXPECT_EQ(parse_number("5."), 5.0);
  EXPECT_EQ(parse_number("0.1"), 0.1);
  for (const char* wrong : {"", " 1", "1 ", "1,5", "1.2.3", "1e", "+-1", "++1", "+", "-", "0x10", "nan", "NaN", "inf",
                            "-Infinity", "1e400", "12mm", "1'000", "one"}) {
    EXPECT_FALSE(parse_number(wrong).has_value()) << wrong;
  }
}

TEST(ParseQuantity, TurnsNumberAndUnitIntoSi) {
  EXPECT_DOUBLE_EQ(parse_quantity("30 mm", length, "here"), 0.030);
  EXPECT_DOUBLE_EQ(parse_quantity("  1.5e2 \t kPa ", pressure, "here"), 150e3);
  EXPECT_DOUBLE_EQ(parse_quantity("-90 deg", angle, "here"), -std::acos(0.0));
  EXPECT_DOUBLE_EQ(parse_quantity("1.07 g/cm3", density, "here"), 1070);
  EXPECT_DOUBLE_EQ(parse_quantity("0.3", pure, "here"), 0.3);
  EXPECT_DOUBLE_EQ(parse_quantity("2 %", pure, "here"), 0.02);
}

TEST(ParseQuantity, EveryUnitOfEveryQuantityIsUnderstood) {
  for (const Quantity quantity : kQuantities) {
    for (const std::string& unit : units_of(quantity)) {
      if (unit == "1") continue;
      EXPECT_DOUBLE_EQ(parse_quantity("2.5 " + unit, quantity, "here"), 2.5 * kTable.at(quantity).at(unit)) << unit;
    }
  }
}

TEST(ParseQuantity, WrongTextIsAnsweredWithARemedy) {
  expect_input_error([] { parse_quantity("30", length, "beam.length"); },
                     {"beam.length: ", "'30' has no unit", "m, mm, cm", "'30 m'"});
  expect_input_error([] { parse_quantity("30mm", length, "here"); }, {"put a blank", "'30 mm'"});
  expect_input_error([] { parse_quantity("0,5 mm", length, "here"); }, {"'0,5 mm'", "decimal point"});
  expect_input_error([] { parse_quantity("", length, "here"); }, {"''", "does not begin with a finite number"});
  expect_input_error([] { parse_quantity("mm", length, "here"); }, {"'mm'", "does not begin with a finite number"});
  expect_input_error([] { parse_quantity("nan mm", length, "here"); }, {"'nan mm'", "finite"});
  expect_input_error([] { parse_quantity("1e999 mm", length, "here"); }, {"'1e999 mm'", "finite"});
  expect_input_error([] { parse_quantity("30 kg", length, "here"); }, {"'kg' is not a unit of length", "unit of mass"});
  expect_input_error([] { parse_quantity("30 mm mm", length, "here"); }, {"'mm mm' is not a unit of length"});
  expect_input_error([] { parse_quantity("0.3 mm", pure, "here"); }, {"has the unit 'mm'", "pure number", "30 %"});
  expect_input_error([] { parse_quantity("2%", pure, "here"); }, {"put a blank", "'2 %'"});
}

TEST(WithUnit, ChoosesAHandyUnit) {
  EXPECT_EQ(with_unit(263824, "Pa"), "263.8 kPa");
  EXPECT_EQ(with_unit(0.00649, "m"), "6.49 mm");
  EXPECT_EQ(with_unit(0.03, "m"), "30 mm");
  EXPECT_EQ(with_unit(-0.00649, "m"), "-6.49 mm");
  EXPECT_EQ(with_unit(2.2e9, "Pa"), "2.2 GPa");
  EXPECT_EQ(with_unit(12, "Pa"), "12 Pa");
  EXPECT_EQ(with_unit(0.05, "kg"), "50 g");
  EXPECT_EQ(with_unit(0.4905, "N"), "490.5 mN");
  EXPECT_EQ(with_unit(5e-5, "m2"), "50 mm2");
  EXPECT_EQ(with_unit(0.5, "m2"), "0.5 m2");
  EXPECT_EQ(with_unit(15000, "N/m"), "15 N/mm");
  EXPECT_EQ(with_unit(1070, "kg/m3"), "1070 kg/m3");
  EXPECT_EQ(with_unit(9.80665, "m/s2"), "9.807 m/s2");
}

TEST(WithUnit, RoundsBeforeItChoosesTheUnit) {
  EXPECT_EQ(with_unit(999.94, "Pa"), "999.9 Pa");
  EXPECT_EQ(with_unit(999.96, "Pa"), "1 kPa");
  EXPECT_EQ(with_unit(0.00099999, "m"), "1 mm");
}

TEST(WithUnit, KeepsAsManyDigitsAsAsked) {
  EXPECT_EQ(with_unit(263824, "Pa", 2), "260 kPa");
  EXPECT_EQ(with_unit(263824, "Pa", 6), "263.824 kPa");
  EXPECT_EQ(with_unit(263824, "Pa", 1), "300 kPa");
}

TEST(WithUnit, ZeroPureAndUnknownUnits) {
  EXPECT_EQ(with_unit(0, "Pa"), "0 Pa");
  EXPECT_EQ(with_unit(-0.0, "m"), "0 m");
  EXPECT_EQ(with_unit(0.3, "1"), "0.3");
  EXPECT_EQ(with_unit(0, "1"), "0");
  EXPECT_EQ(with_unit(263824, "W"), "263800 W");
  EXPECT_EQ(with_unit(1.5e-7, "Pa s"), "1.5e-07 Pa s");
  EXPECT_EQ(with_unit(std::numeric_limits<double>::infinity(), "Pa"), "inf Pa");
}

TEST(WithUnit, MantissasLieBetweenOneAndAThousandWhereAUnitAllowsIt) {
  const std::map<std::string, std::pair<int, int>> decades = {{"m", {-6, 5}},  {"kg", {-6, 2}}, {"N", {-3, 5}},
                                                              {"Pa", {0, 11}}, {"s", {-3, 2}},  {"N/m", {0, 5}}};
  for (const auto& [unit, range] : decades) {
    for (int decade = range.first; decade <= range.second; ++decade) {
      for (const double digit : {1.0, 3.217, 9.9949}) {
        const double value = digit * std::pow(10.0, decade);
        const DisplayUnit display = display_unit(value, unit);
        EXPECT_GE(value / display.factor, 1 - 1e-12) << value << " " << unit;
        EXPECT_LT(value / display.factor, 1000) << value << " " << unit;
      }
    }
  }
}

TEST(WithUnit, WhatIsPrintedReadsBackAsTheRoundedValue) {
  const std::map<std::string, Quantity> si = {
      {"m", length}, {"m2", area},           {"kg", mass},   {"N", force}, {"Pa", pressure},  {"kg/m3", density},
      {"s", time},   {"m/s2", acceleration}, {"rad", angle}, {"1", pure},  {"N/m", stiffness}};
  for (const auto& [unit, quantity] : si) {
    for (int decade = -8; decade <= 12; ++decade) {
      for (const double digit : {1.0, -2.638, 9.999}) {
        const double value = digit * std::pow(10.0, decade);
        const std::string text = with_unit(value, unit);
        EXPECT_NEAR(parse_quantity(text, quantity, "here"), value, 1e-13 * std::abs(value)) << text;
        const DisplayUnit display = display_unit(value, unit);
        EXPECT_EQ(display.factor, unit_factor(display.name, quantity, "here"));
        EXPECT_TRUE(unit == "1" || text.ends_with(" " + display.name)) << text;
      }
    }
  }
  EXPECT_DOUBLE_EQ(parse_quantity(with_unit(12340, "N/m"), line_load, "here"), 12340);
}

TEST(ParseHeader, SplitsNameAndUnit) {
  const HeaderUnit load = parse_header("tip_load_N", {force}, "here");
  EXPECT_EQ(load.name, "tip_load");
  EXPECT_EQ(load.unit, "N");
  EXPECT_EQ(load.quantity, force);
  EXPECT_EQ(load.factor, 1.0);
  const HeaderUnit hung = parse_header("hung_g", {force, mass}, "here");
  EXPECT_EQ(hung.quantity, mass);
  EXPECT_DOUBLE_EQ(hung.factor, 1e-3);
  EXPECT_EQ(parse_header("strain_%", {pure}, "here").factor, 1e-2);
}

TEST(ParseHeader, ASlashIsWrittenPer) {
  const HeaderUnit spring = parse_header("k_N_per_mm", {length, stiffness}, "here");
  EXPECT_EQ(spring.name, "k");
  EXPECT_EQ(spring.unit, "N/mm");
  EXPECT_EQ(spring.quantity, stiffness);
  EXPECT_EQ(parse_header("q_N_per_m", {line_load, stiffness}, "here").quantity, line_load);
  expect_input_error([] { parse_header("k_N_per_mm", {length}, "here"); }, {"a unit of stiffness", "length is needed"});
}

TEST(ParseHeader, EveryUnitGoesRoundThroughAHeader) {
  for (const Quantity quantity : kQuantities) {
    for (const std::string& unit : units_of(quantity)) {
      std::string suffix = unit;
      if (const size_t slash = suffix.find('/'); slash != std::string::npos) suffix.replace(slash, 1, "_per_");
      const HeaderUnit parsed = parse_header("some_thing_" + suffix, {quantity}, "here");
      EXPECT_EQ(parsed.name, "some_thing");
      EXPECT_EQ(parsed.unit, unit);
      EXPECT_EQ(parsed.factor, unit_factor(unit, quantity, "here"));
    }
  }
}

TEST(ParseHeader, AMissingOrWrongUnitIsAnsweredWithAllowedOnesAndAnExample) {
  expect_input_error(
      [] {
        parse_header("mass", {mass, force}, "bench.csv, line 1");
      },
      {"bench.csv, line 1: ", "column 'mass'", "mass or force", "_kg, _g, _mg, _lb, _oz, _N", "'mass_kg'"});
  expect_input_error([] { parse_header("drop_s", {length}, "here"); },
                     {"'s', a unit of time", "length is needed", "_mm", "'drop_m'"});
  expect_input_error([] { parse_header("hung_lbs", {mass}, "here"); }, {"did you mean 'hung_lb'?", "'hung_kg'"});
  expect_input_error([] { parse_header("marker_1", {length}, "here"); }, {"does not end in a unit of length"});
  expect_input_error([] { parse_header("_mm", {length}, "here"); }, {"does not end in a unit of length"});
}

TEST(Units, SpellingsOfOthersAreKnown) {
  for (const char* unit : {"um", "\xC2\xB5m", "\xCE\xBCm"})
    EXPECT_DOUBLE_EQ(unit_factor(unit, Quantity::length, "x"), 1e-6);
  for (const char* unit : {"Nm", "N*m", "N\xC2\xB7m"}) EXPECT_DOUBLE_EQ(unit_factor(unit, Quantity::torque, "x"), 1);
  EXPECT_DOUBLE_EQ(unit_factor("inch", Quantity::length, "x"), 0.0254);
  EXPECT_DOUBLE_EQ(unit_factor("oz", Quantity::mass, "x"), 0.028349523125);
  EXPECT_DOUBLE_EQ(unit_factor("lbf", Quantity::force, "x"), 4.4482216152605);
  EXPECT_DOUBLE_EQ(unit_factor("N/mm\xC2\xB2", Quantity::pressure, "x"), 1e6);
}

TEST(Units, ARowOfUnitsHoldsAUnitAtLeast) {
  EXPECT_TRUE(like_units({"mm", "", "-"}));
  EXPECT_TRUE(like_units({"[furlong]", ""})) << "not one of ours, but in brackets";
  EXPECT_FALSE(like_units({"", ""}));
  EXPECT_FALSE(like_units({"-", ""}));
  EXPECT_FALSE(like_units({"mm", "12"}));
  EXPECT_FALSE(like_units({"mm", "a remark on the specimen"}));
}

TEST(Units, TheNearestUnitIsTheOneOfAnotherCase) {
  expect_input_error([] { unit_factor("MM", Quantity::length, "x"); }, {"did you mean 'mm'?"});
  expect_input_error([] { parse_header("drop_MM", {Quantity::length}, "x"); }, {"did you mean 'drop_mm'?"});
}

}  // namespace
}  // namespace taut
