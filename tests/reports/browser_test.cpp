#include <gtest/gtest.h>

#include <array>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <nlohmann/json.hpp>

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
class Browser : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    if (std::system("command -v chromium >/dev/null 2>&1") != 0) return;
    folder_ = new test::TemporaryFolder;
    write_run(record(), *folder_ / "run");
    write_run(test::hanging_block(), *folder_ / "lines");
    write_simulation(test::bending_beam(11), *folder_ / "simulation");
  }
  static void TearDownTestSuite() {
    delete folder_;
    folder_ = nullptr;
  }
  void SetUp() override {
    if (folder_ == nullptr) GTEST_SKIP() << "chromium is not installed: experiments/install browser";
  }

  static RunRecord record() {
    RunRecord record = test::push_puppet_module();
    for (ReadingRecord& reading : record.readings) {
      // Its mass as the load, so that readings find their shapes; the record has newtons.
      reading.controls[0] /= 9.80665;
    }
    record.controls[0] = make_axis("mass", Quantity::mass, "mass");
    return record;
  }

  /// What the page looks like after `steps`, in a frame `width` wide; `console`: what was written there.
  static Json look(const std::string& page, int width, bool dark, const std::string& steps = "") {
    std::string probe = with(kProbe, "@STEPS@", steps);
    probe = with(with(probe, "@WIDTH@", std::to_string(width)), "@PAGE@", page);
    const std::string file = *folder_ / "probe.html";
    std::ofstream(file) << probe;
    const std::string profile = *folder_ / "profile", log = *folder_ / "log";
    const std::string dom = output_of(
        "timeout 120 chromium --headless --no-sandbox --disable-gpu --disable-dev-shm-usage --no-first-run "
        "--allow-file-access-from-files --window-size=1400,1000 --virtual-time-budget=3000 "
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
      if (line.find("CONSOLE") != std::string::npos) console += line + "\n";
    }
    seen["console"] = console;
    return seen;
  }

  static inline test::TemporaryFolder* folder_ = nullptr;
};

TEST_F(Browser, PagesFitPhonesAndDesktopsInLightAndDarkWithTextOfElevenPixelsAndContrast) {
  for (const char* page : {"run/report.html", "lines/report.html", "simulation/report.html"}) {
    for (const int width : {1280, 390}) {
      for (const bool dark : {false, true}) {
        SCOPED_TRACE(std::string(page) + (dark ? ", dark, " : ", light, ") + std::to_string(width));
        const Json seen = look(page, width, dark);
        ASSERT_FALSE(seen.contains("error")) << seen;
        EXPECT_EQ(seen["console"], "");
        EXPECT_EQ(seen["dark"], dark);
        EXPECT_LE(seen["overflow"], 0);
        EXPECT_GE(seen["smallest"].get<double>(), 11 - 1e-6) << seen["smallest_text"];
        EXPECT_GE(seen["contrast"].get<double>(), 4.5) << seen["contrast_text"];
      }
    }
  }
}

}  // namespace
}  // namespace taut
