#include <fmt/format.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <numbers>
#include <sstream>

#include "reports/report.hpp"
#include "reports/simulation_report.hpp"
#include "sim/core/units.hpp"
#include "tests/support/experiment_files.hpp"
#include "tests/support/run_records.hpp"
#include "tests/support/simulation_records.hpp"

// Pages as a browser shows them. Needs Chromium (experiments/install browser), else all of this is skipped.
namespace taut {
namespace {

using Json = nlohmann::json;

/// Looks at a page in a frame of some width (a browser's window is never narrower than 500 pixels) and writes what it
/// sees as JSON. `@STEPS@` may act on the page first: `page` is its document, `seen` what is reported.
const char* const kProbe = R"html(<!DOCTYPE html><html><body style="margin:0">
<iframe id="frame" style="width:@WIDTH@px;height:900px;border:0" src="@PAGE@"></iframe><pre id="seen"></pre><script>
onload = () => {
  const frame = document.getElementById('frame'), page = frame.contentDocument, view = frame.contentWindow, seen = {};
  try {
    @STEPS@
    seen.overflow = page.documentElement.scrollWidth - view.innerWidth;
    seen.dark = view.matchMedia('(prefers-color-scheme: dark)').matches;
    // What is shown of each piece of text, magnified as its picture is.
    seen.smallest = 1e9;
    seen.contrast = 1e9;
    const texts = page.createTreeWalker(page.body, NodeFilter.SHOW_TEXT);
    const channels = c => c.match(/[\d.]+/g).map(Number);
    const light = c => {
      const [r, g, b] = c.map(v => v / 255).map(v => v <= 0.03928 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);
      return 0.2126 * r + 0.7152 * g + 0.0722 * b;
    };
    while (texts.nextNode()) {
      const element = texts.currentNode.parentElement, style = view.getComputedStyle(element);
      if (!texts.currentNode.data.trim() || !element.getClientRects().length || ['SCRIPT', 'STYLE', 'TITLE', 'title'].includes(element.tagName)) continue;
      const drawn = element.ownerSVGElement, scale = drawn ? Math.hypot(element.getScreenCTM().a, element.getScreenCTM().b) : 1;
      const size = parseFloat(style.fontSize) * scale;
      if (size < seen.smallest) { seen.smallest = size; seen.smallest_text = texts.currentNode.data; }
      if (drawn) continue;
      let behind = [0, 0, 0, 0], e = element;
      const layers = [];
      for (; e; e = e.parentElement) layers.unshift(channels(view.getComputedStyle(e).backgroundColor));
      behind = layers.reduce((under, l) => { const a = l[3] ?? 1; return [0, 1, 2].map(i => a * l[i] + (1 - a) * under[i]); }, [255, 255, 255]);
      const [a, b] = [light(channels(style.color)), light(behind)], ratio = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
      if (ratio < seen.contrast) { seen.contrast = ratio; seen.contrast_text = texts.currentNode.data; }
    }
  } catch (e) { seen.error = String(e.stack); }
  document.getElementById('seen').textContent = JSON.stringify(seen);
};
</script></body></html>)html";

std::string with(std::string text, const std::string& mark, const std::string& by) {
  for (size_t at = text.find(mark); at != std::string::npos; at = text.find(mark, at + by.size()))
    text.replace(at, mark.size(), by);
  return text;
}

std::string output_of(const std::string& command) {
  std::string output;
  FILE* pipe = popen(command.c_str(), "r");
  std::array<char, 4096> block{};
  while (const size_t n = fread(block.data(), 1, block.size(), pipe)) output.append(block.data(), n);
  pclose(pipe);
  return output;
}

/// A run's page and a simulation's, written once.
class SlowBrowser : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    if (std::system("command -v chromium >/dev/null 2>&1") != 0) return;
    folder_ = new test::TemporaryFolder;
    write_run(record(), *folder_ / "run");
    write_run(test::hanging_block(), *folder_ / "lines");
    write_run(test::block_in_space(), *folder_ / "space");
    write_simulation(test::bending_beam(11), *folder_ / "simulation");
  }
  static void TearDownTestSuite() {
    delete folder_;
    folder_ = nullptr;
  }
  void SetUp() override {
    if (folder_ == nullptr) GTEST_SKIP() << "chromium is not installed: experiments/install browser";
  }

  /// The series that has no retraction as benches call it.
  static std::string with_zero(const std::string& series) {
    return series == "retraction 0.00 mm" ? "retraction 0 mm" : series;
  }

  static RunRecord record() {
    RunRecord record = test::push_puppet_module();
    for (ReadingRecord& reading : record.readings) {
      // Its mass as the load, so that readings find their shapes; the record has newtons.
      reading.controls[0] /= 9.80665;
    }
    record.controls[0] = make_axis("mass", Quantity::mass, "mass");
    for (std::string& series : record.series) series = with_zero(series);
    for (CurveRecord& curve : record.curves) curve.series = with_zero(curve.series);
    record.start_curves = record.curves;
    for (CurveRecord& curve : record.start_curves) {
      for (double& value : curve.value) value /= 2;
    }
    return record;
  }

  /// What the page looks like after `steps`, in a frame `width` wide; `console`: what was written there.
  static Json look(const std::string& page, int width, bool dark, const std::string& steps = "",
                   const std::string& option = "--enable-unsafe-swiftshader") {  // drawing in space by the processor
    std::string probe = with(kProbe, "@STEPS@", steps);
    probe = with(with(probe, "@WIDTH@", std::to_string(width)), "@PAGE@", page);
    const std::string file = *folder_ / "probe.html";
    std::ofstream(file) << probe;
    const std::string profile = *folder_ / "profile", log = *folder_ / "log";
    const std::string dom = output_of(
        "timeout 120 chromium --headless --no-sandbox --disable-gpu --disable-dev-shm-usage --no-first-run "
        "--allow-file-access-from-files " +
        option +
        " --window-size=1400,1000 --virtual-time-budget=3000 "
        "--enable-logging=stderr --user-data-dir='" +
        profile + "' --blink-settings=preferredColorScheme=" + (dark ? "0" : "1") + " --dump-dom 'file://" + file +
        "' 2>'" + log + "'");
    const std::string mark = "<pre id=\"seen\">";
    const size_t at = dom.find(mark);
    if (at == std::string::npos) return {{"error", "no page: " + read_file(log).substr(0, 2000)}};
    std::string text = dom.substr(at + mark.size(), dom.find("</pre>", at) - at - mark.size());
    text = with(with(with(text, "&lt;", "<"), "&gt;", ">"), "&amp;", "&");
    Json seen = Json::parse(text, nullptr, false);
    if (seen.is_discarded()) return {{"error", text}};
    std::string console;
    std::istringstream lines(read_file(log));
    for (std::string line; std::getline(lines, line);) {
      const bool of_driver = line.find("GL Driver Message") != std::string::npos;  // how fast the processor draws
      if (line.find("CONSOLE") != std::string::npos && !of_driver) console += line + "\n";
    }
    seen["console"] = console;
    return seen;
  }

  static inline test::TemporaryFolder* folder_ = nullptr;
};

TEST_F(SlowBrowser, PagesFitPhonesAndDesktopsInLightAndDarkWithTextOfElevenPixelsAndContrast) {
  for (const char* page : {"run/report.html", "lines/report.html", "space/report.html", "simulation/report.html"}) {
    for (const int width : {1280, 390}) {
      for (const bool dark : {false, true}) {
        SCOPED_TRACE(std::string(page) + (dark ? ", dark, " : ", light, ") + std::to_string(width));
        const Json seen = look(page, width, dark);
        ASSERT_FALSE(seen.contains("error")) << seen;
        EXPECT_EQ(seen["console"], "");
        EXPECT_LT(std::filesystem::file_size(*folder_ / page), 3u << 20);
        EXPECT_EQ(seen["dark"], dark);
        EXPECT_LE(seen["overflow"], 0);
        EXPECT_GE(seen["smallest"].get<double>(), 11 - 1e-6) << seen["smallest_text"];
        EXPECT_GE(seen["contrast"].get<double>(), 4.5) << seen["contrast_text"];
      }
    }
  }
}

/// Steps that all tests of charts begin with.
const char* const kChart = R"js(
    const chart = name => page.querySelector('#figure-' + name + ' .live');
    const key = (element, name) => element.dispatchEvent(new view.KeyboardEvent('keydown', {key: name, bubbles: true}));
    const graph = name => chart(name).querySelector('svg[tabindex]');
    const marks = name => graph(name).querySelectorAll('path[transform]').length;
)js";

TEST_F(SlowBrowser, WithoutTheScriptAndOnPaperThePicturesStandThere) {
  const std::string page = read_file(*folder_ / "run/report.html");
  std::ofstream(*folder_ / "run/still.html") << with(page, "<script>", "<script type=\"off\">");
  const std::string shown = R"js(
    const visible = what => [...page.querySelectorAll(what)].filter(e => e.getClientRects().length).length;
    seen.pictures = visible('.picture');
    seen.live = visible('.live');
    // As paper has it: rules for screens go, those for print stay.
    if (@PRINT@) {
      for (const rule of [...page.styleSheets[0].cssRules])
        if (rule.media) rule.media.mediaText = rule.media.mediaText === 'print' ? 'all' : 'not all';
      seen.pictures_on_paper = visible('.picture');
      seen.live_on_paper = visible('.live');
    }
  )js";
  const Json still = look("run/still.html", 390, true, with(shown, "@PRINT@", "false"));
  ASSERT_FALSE(still.contains("error")) << still;
  EXPECT_EQ(still["live"], 0);
  EXPECT_LE(still["overflow"], 0);
  EXPECT_GE(still["smallest"].get<double>(), 11 - 1e-6) << still["smallest_text"];
  const Json moving = look("run/report.html", 1280, false, with(shown, "@PRINT@", "true"));
  ASSERT_FALSE(moving.contains("error")) << moving;
  EXPECT_GE(still["pictures"], 6);
  EXPECT_EQ(moving["live"], 4);
  EXPECT_EQ(moving["pictures"].get<int>() + 4, still["pictures"].get<int>());
  EXPECT_EQ(moving["pictures_on_paper"], still["pictures"]);
  EXPECT_EQ(moving["live_on_paper"], 0);
}

TEST_F(SlowBrowser, AReadingSaysItsLineTrialValueAndResidual) {
  const RunRecord run = record();
  const Json seen = look("run/report.html", 1280, false, std::string(kChart) + R"js(
    for (const name of ['force_displacement', 'residuals']) {
      key(graph(name), 'ArrowRight');
      key(graph(name), 'ArrowRight');
      seen[name] = chart(name).querySelector('.tip').textContent;
    }
  )js");
  ASSERT_FALSE(seen.contains("error")) << seen;
  const ReadingRecord& second = run.readings[1];
  const std::string minus = "−";
  const auto written = [&](double value, int digits) {
    const std::string text = fmt::format("{:.{}g}", value, digits);
    return text[0] == '-' ? minus + text.substr(1) : text;
  };
  const double miss = 1e3 * (second.measured - second.predicted);
  const std::string expected = fmt::format(
      "line {}, trial {}, {}\nmass 50 g, retraction 0 mm\nmeasured {} ± {} mm\nfitted {} mm\nresidual {} mm ({} σ)",
      second.line, second.trial, second.channel, written(1e3 * second.measured, 4), written(1e3 * second.sigma, 2),
      written(1e3 * second.predicted, 4), written(miss, 3), written(miss / (1e3 * second.sigma), 3));
  for (const char* name : {"force_displacement", "residuals"})
    EXPECT_EQ(seen[name].get<std::string>().substr(0, expected.size()), expected);
}

TEST_F(SlowBrowser, SeriesAndTrialsSwitchOffAndOnAndZoomShowsLess) {
  const Json seen = look("run/report.html", 1280, false, std::string(kChart) + R"js(
    const buttons = [...chart('force_displacement').querySelectorAll('.switches button')];
    seen.buttons = buttons.map(b => b.textContent);
    seen.all = marks('force_displacement');
    buttons[1].click();
    seen.without_series = marks('force_displacement');
    seen.pressed = buttons[1].getAttribute('aria-pressed');
    buttons[6].click();
    seen.without_trial = marks('force_displacement');
    buttons[1].click();
    buttons[6].click();
    seen.again = marks('force_displacement');
    const tics = () => [...graph('force_displacement').querySelectorAll('text[text-anchor=middle]')].map(t => parseFloat(t.textContent)).filter(isFinite);
    const span = list => Math.max(...list) - Math.min(...list);
    seen.wide = span(tics());
    key(graph('force_displacement'), '+');
    key(graph('force_displacement'), '+');
    seen.narrow = span(tics());
    key(graph('force_displacement'), '0');
    seen.wide_again = span(tics());
    // Half of the fitted curve: the start's ends stand half as far from the axis of the load.
    const ends = dashed => [...graph('force_displacement').querySelectorAll('g path[fill=none]')]
      .filter(p => Boolean(p.getAttribute('stroke-dasharray')) === dashed && p.getAttribute('d').includes('L') && p.getAttribute('stroke-width') === '1.8')
      .map(p => parseFloat(p.getAttribute('d').match(/L([-\d.]+) [-\d.]+$/)[1]));
    seen.fitted = ends(false);
    seen.start = ends(true);
    buttons[buttons.length - 1].click();
    seen.no_start = ends(true);
  )js");
  ASSERT_FALSE(seen.contains("error")) << seen;
  EXPECT_EQ(seen["buttons"].size(), 4 + 3 + 1) << seen["buttons"];  // retractions, trials, start
  EXPECT_EQ(seen["all"], 48);
  EXPECT_EQ(seen["without_series"], 36);
  EXPECT_EQ(seen["pressed"], "false");
  EXPECT_EQ(seen["without_trial"], 24);
  EXPECT_EQ(seen["again"], 48);
  EXPECT_LT(seen["narrow"].get<double>(), 0.8 * seen["wide"].get<double>());
  EXPECT_EQ(seen["wide_again"], seen["wide"]);
  ASSERT_EQ(seen["start"].size(), 4);
  ASSERT_EQ(seen["fitted"].size(), 4);
  constexpr double axis = 52;  // px
  for (size_t i = 0; i < 4; ++i)
    EXPECT_NEAR(seen["start"][i].get<double>() - axis, (seen["fitted"][i].get<double>() - axis) / 2, 0.2);
  EXPECT_TRUE(seen["no_start"].empty());
}

TEST_F(SlowBrowser, APointOfTheStiffnessShowsTheShapeOfItsConditionWhereTheRecordHasIt) {
  const RunRecord run = record();
  const Json seen = look("run/report.html", 1280, false, std::string(kChart) + R"js(
    key(graph('effective_stiffness'), 'ArrowRight');
    key(graph('effective_stiffness'), 'Enter');
    const pinned = chart('effective_stiffness').querySelector('.pinned');
    seen.label = pinned.querySelector('b').textContent;
    seen.tip = chart('effective_stiffness').querySelector('.tip').textContent;
    // Twice the outline's width in mm, by the scale bar.
    const outline = pinned.querySelector('path[stroke="var(--ink)"]').getBBox();
    const bar = pinned.querySelector('path[stroke="var(--soft)"]').getBBox(), mm = parseFloat(pinned.querySelector('text').textContent);
    seen.width = outline.width / bar.width * mm;
    seen.cables = pinned.querySelectorAll('path[stroke="var(--cable)"]').length;
    const shapes = page.querySelector('#figure-deformed_shapes .live');
    seen.viewer = [...shapes.querySelectorAll('output')].map(o => o.textContent);
    seen.read = shapes.querySelector('.note').textContent;
    const sliders = shapes.querySelectorAll('input');
    sliders[0].value = 2;
    sliders[0].dispatchEvent(new view.Event('input'));
    seen.next = [...shapes.querySelectorAll('output')].map(o => o.textContent);
  )js");
  ASSERT_FALSE(seen.contains("error")) << seen;
  EXPECT_EQ(seen["label"], "Shape: retraction 0 mm, mass 50 g");
  // Load over displacement of the first reading.
  const ReadingRecord& first = run.readings[0];
  EXPECT_NE(
      seen["tip"].get<std::string>().find(fmt::format("stiffness {:.4g} ± ", run.load_newtons[0] / first.measured)),
      std::string::npos)
      << seen["tip"];
  double left = INFINITY, right = -INFINITY;
  for (const auto& [x0, y0, x1, y1] : run.shapes[2].segments) {
    left = std::min({left, x0, x1});
    right = std::max({right, x0, x1});
  }
  EXPECT_NEAR(seen["width"].get<double>(), 1e3 * (right - left), 0.3);
  EXPECT_EQ(seen["cables"], 2);
  EXPECT_EQ(seen["viewer"], Json({"retraction 0 mm", "mass 50 g"}));
  EXPECT_NE(seen["read"].get<std::string>().find("tip: measured 3.55, 3.52, 3.56; fitted"), std::string::npos)
      << seen["read"];
  EXPECT_EQ(seen["next"], Json({"retraction 11.79 mm", "mass 50 g"}));
}

/// How wide and high something is on the screen [mm] that is seen from an azimuth and an elevation [rad], z up.
std::array<double, 2> seen_size(const std::vector<std::vector<double>>& bodies, double azimuth, double elevation) {
  const std::array right{-std::sin(azimuth), std::cos(azimuth), 0.0},
      up{-std::sin(elevation) * std::cos(azimuth), -std::sin(elevation) * std::sin(azimuth), std::cos(elevation)};
  std::array<double, 2> size{};
  for (const auto& [axis, out] : {std::pair(right, &size[0]), std::pair(up, &size[1])}) {
    double low = INFINITY, high = -INFINITY;
    for (const std::vector<double>& points : bodies) {
      for (size_t i = 0; i < points.size(); i += 3) {
        const double at = axis[0] * points[i] + axis[1] * points[i + 1] + axis[2] * points[i + 2];
        low = std::min(low, at);
        high = std::max(high, at);
      }
    }
    *out = 1e3 * (high - low);
  }
  return size;
}

TEST_F(SlowBrowser, ShapesInSpaceAreDrawnToScaleTurnAndSayTheLargestContactForce) {
  const RunRecord run = test::block_in_space();
  const Json seen = look("space/report.html", 1280, false, std::string(kChart) + R"js(
    const shapes = page.querySelector('#figure-deformed_shapes .live'), svg = shapes.querySelector('svg[tabindex]');
    // What is painted of the canvas, in mm by the scale bar.
    const measure = () => {
      const canvas = shapes.querySelector('canvas'), {width, height} = canvas, ratio = width / canvas.clientWidth;
      const data = canvas.getContext('2d').getImageData(0, 0, width, height).data;
      let [x0, x1, y0, y1] = [width, 0, height, 0];
      for (let y = 0; y < height; ++y) for (let x = 0; x < width; ++x) if (data[4 * (y * width + x) + 3] > 60) {
        [x0, x1, y0, y1] = [Math.min(x0, x), Math.max(x1, x + 1), Math.min(y0, y), Math.max(y1, y + 1)];
      }
      const bar = svg.querySelector('path[stroke="var(--soft)"]').getBBox().width, mm = parseFloat(svg.querySelector('text:not([class])').textContent);
      return [x1 - x0, y1 - y0].map(v => v / ratio / bar * mm);
    };
    const input = shapes.querySelector('input');
    input.value = 2;
    input.dispatchEvent(new view.Event('input'));
    seen.label = svg.querySelector('title').textContent;
    seen.whole = measure();
    seen.force = [...svg.querySelectorAll('.force-size')].map(t => t.textContent);
    seen.said = shapes.querySelector('.note').textContent;
    seen.cables = svg.querySelectorAll('path[stroke="var(--cable)"]').length;
    svg.dispatchEvent(new view.KeyboardEvent('keydown', {key: 'ArrowRight', shiftKey: true, bubbles: true}));
    svg.dispatchEvent(new view.KeyboardEvent('keydown', {key: 'ArrowUp', shiftKey: true, bubbles: true}));
    seen.turned = measure();
    key(graph('effective_stiffness'), 'ArrowRight');
    key(graph('effective_stiffness'), 'Enter');
    const pinned = chart('effective_stiffness').querySelector('.pinned canvas');
    const data = pinned.getContext('2d').getImageData(0, 0, pinned.width, pinned.height).data;
    seen.pinned = data.filter((_, i) => i % 4 === 3 && data[i] > 60).length;
  )js");
  ASSERT_FALSE(seen.contains("error")) << seen;
  EXPECT_EQ(seen["label"], "Deformed shape: tip_load 1.001 N");
  const std::vector<std::vector<double>> drawn{run.shapes[0].points, run.shapes[3].points};  // at rest in grey lines
  for (const auto& [name, azimuth, elevation] :
       {std::tuple("whole", -std::numbers::pi / 4, 0.5), std::tuple("turned", -std::numbers::pi / 4 - 0.15, 0.35)}) {
    const std::array<double, 2> expected = seen_size(drawn, azimuth, elevation);
    for (size_t i = 0; i < 2; ++i) EXPECT_NEAR(seen[name][i].get<double>(), expected[i], 0.02 * expected[i]) << name;
  }
  EXPECT_EQ(seen["force"], Json({"2.5 N"}));
  EXPECT_NE(seen["said"].get<std::string>().find("Contact presses on one patch, hardest with 2.5 N."),
            std::string::npos)
      << seen["said"];
  EXPECT_EQ(seen["cables"], 1);
  EXPECT_GT(seen["pinned"].get<int>(), 1000);
}

TEST_F(SlowBrowser, WithoutWebGLThePictureOfTheShapesStandsThere) {
  const Json seen = look("space/report.html", 1280, false, R"js(
    const figure = page.querySelector('#figure-deformed_shapes');
    seen.live = figure.querySelectorAll('.live').length;
    seen.picture = figure.querySelector('.picture').getClientRects().length;
    seen.charts = page.querySelectorAll('.live').length;
  )js",
                         "--disable-3d-apis");
  ASSERT_FALSE(seen.contains("error")) << seen;
  EXPECT_EQ(seen["console"], "");
  EXPECT_EQ(seen["live"], 0);
  EXPECT_EQ(seen["picture"], 1);
  EXPECT_EQ(seen["charts"], 4);
}

TEST_F(SlowBrowser, TheWayOfTheSearchSaysChiSquaredAndParametersOfEachEvaluation) {
  const Json seen = look("space/report.html", 390, true, std::string(kChart) + R"js(
    seen.tips = [...chart('search_history').querySelectorAll('svg[tabindex]')].map(svg => {
      key(svg, 'ArrowLeft');
      key(svg, 'ArrowLeft');
      const tip = svg.parentElement.querySelector('.tip').textContent;
      return [svg.querySelectorAll('path[transform]').length, tip];
    });
  )js");
  ASSERT_FALSE(seen.contains("error")) << seen;
  EXPECT_EQ(
      seen["tips"],
      Json::parse(R"([[3, "evaluation 2, search\nchi squared 71"], [4, "evaluation 3, search\nE_silicone 1 kPa"]])"));
}

TEST_F(SlowBrowser, TablesSortByNumberWhateverTheUnitAndContentsLeadToEveryPart) {
  const Json seen = look("run/report.html", 1280, false, std::string(kChart) + R"js(
    const table = [...page.querySelectorAll('table')].find(t => t.textContent.includes('Residual / σ'));
    const head = [...table.querySelectorAll('thead th')].find(h => h.textContent.includes('Measured'));
    const column = () => [...table.tBodies[0].rows].map(row => parseFloat(row.cells[[...head.parentElement.cells].indexOf(head)].textContent));
    head.querySelector('button').click();
    seen.up = column();
    seen.order = head.getAttribute('aria-sort');
    head.querySelector('button').click();
    seen.down = column();
    seen.links = [...page.querySelectorAll('nav a')].map(a => a.getAttribute('href'));
    seen.missing = seen.links.filter(href => !page.querySelector(href));
    seen.scopes = [...page.querySelectorAll('th:not([scope])')].length;
    seen.pictures = [...page.querySelectorAll('svg[role=img]')].filter(s => !s.getAttribute('aria-label')).length;
    seen.map = [...page.querySelectorAll('#correlations td')].map(td => td.style.background);
  )js");
  ASSERT_FALSE(seen.contains("error")) << seen;
  std::vector<double> up = seen["up"], down = seen["down"];
  EXPECT_EQ(up.size(), 48);
  EXPECT_TRUE(std::ranges::is_sorted(up));
  EXPECT_EQ(seen["order"], "ascending");
  std::ranges::reverse(down);
  EXPECT_TRUE(std::ranges::is_sorted(down));
  EXPECT_GE(seen["links"].size(), 10u);
  EXPECT_TRUE(seen["missing"].empty()) << seen["missing"];
  EXPECT_EQ(seen["scopes"], 0);
  EXPECT_EQ(seen["pictures"], 0);
  ASSERT_EQ(seen["map"].size(), 4);
  EXPECT_EQ(seen["map"][1], "rgba(213, 94, 0, 0.5)");  // -0.83: 0.6 of it
}

}  // namespace
}  // namespace taut
