#include "reports/animation.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <iterator>
#include <nlohmann/json.hpp>

#include "reports/figures.hpp"
#include "reports/html.hpp"
#include "reports/surface.hpp"

namespace taut {
namespace {

using Json = nlohmann::ordered_json;
using plot::kMillimetre;

constexpr double kSteps = 1e4;  // along the window's largest side

const char* const kFragment = R"html(<style>
#motion { border: 1px solid #ddd; border-radius: .3rem; padding: .6rem; margin: 1rem 0; font-size: .9rem; }
#motion canvas { display: block; width: 100%; touch-action: none; }
#motion .bar { display: flex; flex-wrap: wrap; gap: .7rem; align-items: center; margin: .5rem 0; }
#motion .bar input { flex: 1 1 12rem; }
#motion button { min-width: 5rem; padding: .3rem .8rem; font: inherit; cursor: pointer; }
#motion output { font-variant-numeric: tabular-nums; font-weight: 600; min-width: 9rem; }
#motion .key, #motion .note { color: #555; margin: .3rem 0; }
#motion .key i { display: inline-block; width: 1.6em; height: .9em; margin: 0 .4em 0 0; vertical-align: -.1em; }
#motion .key span { margin-right: 1.2em; white-space: nowrap; }
#motion .values { display: grid; grid-template-columns: repeat(auto-fill, minmax(20rem, 1fr)); gap: .1rem 2rem; }
#motion .values h4 { grid-column: 1 / -1; margin: .5rem 0 0; font-size: .9rem; }
#motion .value { display: flex; align-items: center; gap: .5rem; border-bottom: 1px solid #eee; }
#motion .value b { font-weight: 400; flex: 1; }
#motion .value span { font-variant-numeric: tabular-nums; text-align: right; white-space: nowrap; min-width: 6.5rem; }
#motion .value canvas { width: 110px; height: 26px; flex: none; }
</style>
<div id="motion">
<canvas id="scene" role="img" aria-label="Animation of the simulated states"></canvas>
<p class="key"></p>
<div class="bar"><button type="button">Play</button>
<input type="range" min="0" value="0" step="1" aria-label="frame"><output></output>
<label>speed <select></select></label></div>
<p class="note"></p>
<div class="values"></div>
</div>
<script type="application/json" id="simulation-data">@DATA@</script>
<script>
(() => {
const D = JSON.parse(document.getElementById('simulation-data').textContent);
const box = document.getElementById('motion'), canvas = document.getElementById('scene'), pen = canvas.getContext('2d');
const [play, slider, clock, speed] = ['button', 'input', 'output', 'select'].map(t => box.querySelector(t));
const n = D.dimension, flat = n === 2, low = D.window.lower, high = D.window.upper, last = D.frames.length - 1;

// Positions in mm: whole steps from the lower corner, each frame as the difference to the one before.
let sum = null;
const X = D.frames.map(f => {
  sum = sum ? sum.map((v, i) => v + f[i]) : f;
  return Float32Array.from(sum, (v, i) => low[i % n] + D.step * v);
});

// The view: an orthographic projection; drag to turn it.
let azimuth = -Math.PI / 4, elevation = Math.atan(Math.SQRT1_2), right, up, toward;
function turn() {
  const [ca, sa, ce, se] = [Math.cos(azimuth), Math.sin(azimuth), Math.cos(elevation), Math.sin(elevation)];
  right = [-sa, ca, 0]; up = [-se * ca, -se * sa, ce]; toward = [ce * ca, ce * sa, se];
}
turn();
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const seen = p => flat ? p : [dot(p, right), dot(p, up)];
function corners() {
  if (flat) return [low, high];
  const all = [];
  for (let i = 0; i < 8; ++i) all.push(seen([0, 1, 2].map(c => (i >> c & 1 ? high : low)[c])));
  return all;
}
let scale, shift;
function fit() {
  const c = corners(), xs = c.map(p => p[0]), ys = c.map(p => p[1]), margin = 26;
  const [x0, x1, y0, y1] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
  const width = canvas.clientWidth, ratio = window.devicePixelRatio || 1;
  if (!canvas.style.height)
    canvas.style.height = Math.max(260, Math.min(540, (width - 2 * margin) * (y1 - y0) / (x1 - x0) + 2 * margin)) + 'px';
  const height = canvas.clientHeight;
  canvas.width = width * ratio; canvas.height = height * ratio;
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  scale = Math.min((width - 2 * margin) / (x1 - x0), (height - 2 * margin) / (y1 - y0));
  shift = [width / 2 - scale * (x0 + x1) / 2, height / 2 + scale * (y0 + y1) / 2];
}
const px = p => { const q = seen(p); return [shift[0] + scale * q[0], shift[1] - scale * q[1]]; };
const point = (x, i) => Array.from(x.subarray(n * i, n * i + n));

function path(points, closed) {
  points.forEach((p, i) => { const q = px(p); i ? pen.lineTo(q[0], q[1]) : pen.moveTo(q[0], q[1]); });
  if (closed) pen.closePath();
}
function stroke(colour, width) { pen.strokeStyle = colour; pen.lineWidth = width; pen.lineJoin = 'round'; pen.stroke(); }
function chunks(list) { const out = []; for (let i = 0; i < list.length; i += n) out.push(list.slice(i, i + n)); return out; }

function strokes_of(kind) { return chunks(D[kind][Math.min(at, D[kind].length - 1)]); }
function ground(kind) {
  const ends = strokes_of(kind);
  pen.beginPath();
  for (let i = 0; i + 1 < ends.length; i += 2) path([ends[i], ends[i + 1]]);
  stroke('#8a8278', flat ? 1 : 0.6);
}
function is_in_front(x) {
  // What is round, by its middle and that of the bodies.
  const mean = list => list.reduce((sum, p) => sum + dot(p, toward), 0) / list.length, round = strokes_of('round');
  return round.length > 0 && mean(round) > mean(D.nodes.map((_, i) => point(x, i)));
}
function areas(x) {
  D.regions.forEach((region, r) => {
    pen.beginPath();
    D.loops.forEach(loop => { if (loop.region === r) path(loop.points.map(i => point(x, i)), true); });
    pen.fillStyle = region.colour; pen.fill('nonzero');
  });
}
function outlines(x, colour, width) {
  pen.beginPath();
  D.loops.forEach(loop => path(loop.points.map(i => point(x, i)), true));
  stroke(colour, width);
}
const rgb = D.regions.map(r => [1, 3, 5].map(c => parseInt(r.colour.slice(c, c + 2), 16)));
function facets(x) {
  // Painter's algorithm: those that face the viewer, the farthest first.
  const T = D.triangles, list = [];
  let light = [0, 1, 2].map(c => -0.4 * right[c] + 0.7 * up[c] + 0.6 * toward[c]);
  const bright = Math.hypot(...light);
  light = light.map(v => v / bright);
  for (let t = 0; t < T.length; t += 3) {
    const [a, b, c] = [point(x, T[t]), point(x, T[t + 1]), point(x, T[t + 2])];
    const e = b.map((v, i) => v - a[i]), f = c.map((v, i) => v - a[i]);
    const m = [e[1] * f[2] - e[2] * f[1], e[2] * f[0] - e[0] * f[2], e[0] * f[1] - e[1] * f[0]];
    const size = Math.hypot(...m);
    if (dot(m, toward) <= 0.01 * size) continue;
    const brightness = 0.75 + 0.25 * dot(m, light) / size;
    const colour = 'rgb(' + rgb[D.triangle_regions[t / 3]].map(v => Math.round(v * brightness)).join() + ')';
    list.push({depth: dot(a, toward) + dot(b, toward) + dot(c, toward), corners: [a, b, c], colour});
  }
  list.sort((a, b) => a.depth - b.depth);
  for (const facet of list) {
    pen.beginPath(); path(facet.corners, true);
    pen.fillStyle = facet.colour; pen.fill(); stroke(facet.colour, 0.8);
  }
}
function scale_bar(height) {
  const raw = 110 / scale, power = 10 ** Math.floor(Math.log10(raw)), mm = [5, 2, 1].find(f => f * power <= raw) * power;
  pen.strokeStyle = pen.fillStyle = '#555'; pen.lineWidth = 2;
  pen.beginPath(); pen.moveTo(12, 10); pen.lineTo(12, 16); pen.lineTo(12 + mm * scale, 16); pen.lineTo(12 + mm * scale, 10); pen.stroke();
  pen.font = '12px sans-serif'; pen.textAlign = 'left';
  pen.fillText(+mm.toPrecision(2) + ' mm', 18 + mm * scale, 18);
  if (flat) return;
  pen.textAlign = 'center';
  ['x', 'y', 'z'].forEach((name, c) => {
    const p = [0, 1, 2].map(k => k === c ? 26 : 0), q = [dot(p, right), dot(p, up)], o = [44, height - 44];
    pen.lineWidth = 1.2; pen.beginPath(); pen.moveTo(...o); pen.lineTo(o[0] + q[0], o[1] - q[1]); pen.stroke();
    pen.fillText(name, o[0] + 1.4 * q[0], o[1] - 1.4 * q[1] + 4);
  });
}

let at = 0;
function draw() {
  const x = X[at], height = canvas.clientHeight, width = canvas.clientWidth;
  pen.clearRect(0, 0, width, height);
  const front = flat || is_in_front(x);
  if (!flat) ground('ground');
  if (!front) ground('round');
  if (flat && at > 0) outlines(X[0], '#b8b8b8', 1);
  if (flat) { areas(x); outlines(x, '#222', 1); } else facets(x);
  let i = D.nodes.length;
  for (const line of D.lines) {
    pen.beginPath(); path(Array.from({length: line.count}, (_, k) => point(x, i + k))); stroke(line.colour, 1.8);
    i += line.count;
  }
  if (flat) ground('ground');
  if (front) ground('round');
  for (const obstacle of D.obstacles) { pen.beginPath(); path(chunks(obstacle)); stroke('#5a3d2b', 3); }
  scale_bar(height);
  pen.font = 'bold 13px sans-serif'; pen.textAlign = 'right'; pen.fillStyle = '#d55e00';
  pen.fillText('SIMULATION', width - 8, 18);
  slider.value = at;
  clock.textContent = D.sample.name + ' ' + D.sample.values[at].toFixed(D.sample.decimals) + ' ' + D.sample.unit;
  rows.forEach(row => row.show());
}

// Values beside a small curve of each series.
const values = box.querySelector('.values'), ratio = window.devicePixelRatio || 1;
const rows = [];
for (const control of [true, false]) {
  const list = D.series.filter(s => s.control === control);
  if (!list.length) continue;
  values.appendChild(document.createElement('h4')).textContent = control ? 'Prescribed' : 'Computed';
  for (const s of list) {
    const row = values.appendChild(document.createElement('div')); row.className = 'value'; row.title = s.id;
    row.appendChild(document.createElement('b')).textContent = s.meaning || s.id;
    const curve = row.appendChild(document.createElement('canvas')), text = row.appendChild(document.createElement('span'));
    curve.width = 110 * ratio; curve.height = 26 * ratio;
    const p = curve.getContext('2d'); p.scale(ratio, ratio);
    const real = s.values.filter(v => v !== null), a = Math.min(...real), b = Math.max(...real);
    const place = k => [3 + 104 * (last ? k / last : 0), b > a ? 22 - 18 * (s.values[k] - a) / (b - a) : 13];
    rows.push({show() {
      p.clearRect(0, 0, 110, 26); p.beginPath();
      s.values.forEach((v, k) => { if (v !== null) p.lineTo(...place(k)); });
      p.strokeStyle = '#9aa7b0'; p.lineWidth = 1; p.stroke();
      const v = s.values[at];
      if (v !== null) { p.beginPath(); p.arc(...place(at), 3, 0, 7); p.fillStyle = '#d55e00'; p.fill(); }
      text.textContent = v === null ? 'none' : +v.toPrecision(4) + (s.unit ? ' ' + s.unit : '');
    }});
  }
}

// What the colours mean, and what is shown.
const key = box.querySelector('.key');
for (const e of [...D.regions, ...D.lines.map(l => ({...l, thin: true}))]) {
  if (!e.name) continue;
  const span = key.appendChild(document.createElement('span')), mark = span.appendChild(document.createElement('i'));
  mark.style.background = e.colour;
  if (e.thin) mark.style.cssText += 'height:3px;vertical-align:.25em';
  span.append(e.name);
}
let note = 'Everything shown is simulated: ' + D.shown + (D.shown < D.stored ? ' of ' + D.stored : '') + ' stored states'
  + (D.shown < D.stored ? ' (thinned out evenly to keep this file small)' : '') + '.';
if (flat) note += ' Grey outline: the start.'; else note += ' Drag to turn the view.';

// Playing: in real time where the run is one in seconds, else evenly.
const times = D.sample.values.map(v => v * D.sample.seconds);
const timed = D.sample.seconds > 0 && last > 0, length = timed ? times[last] - times[0] : 6;
const when = k => timed ? times[k] - times[0] : length * k / Math.max(last, 1);
const speeds = [0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100];
const usual = speeds.reduce((a, b) => Math.abs(Math.log(length / b / 6)) < Math.abs(Math.log(length / a / 6)) ? b : a);
const start = timed ? (length >= 3 && length <= 20 ? 1 : usual) : 1;
for (const s of speeds) {
  if (s < start / 25 || s > start * 25) continue;
  const option = speed.appendChild(document.createElement('option'));
  option.value = s; option.textContent = s + ' ×' + (timed && s === 1 ? ' (real time)' : ''); option.selected = s === start;
}
if (timed) note += ' Speed 1 × is real time.';
box.querySelector('.note').textContent = note;

let playing = false, position = 0, before = 0;
function step(now) {
  if (!playing) return;
  position += (now - before) / 1000 * speed.value;
  before = now;
  if (position > 1.1 * length) position = 0;  // the end stays for a moment
  let k = 0;
  while (k < last && when(k + 1) <= position) ++k;
  if (k !== at) { at = k; draw(); }
  requestAnimationFrame(step);
}
function set_playing(on) {
  playing = on && last > 0;
  play.textContent = playing ? 'Pause' : 'Play';
  if (playing) {
    if (at === last) at = 0;
    position = when(at); before = performance.now(); requestAnimationFrame(step);
  }
}
play.onclick = () => set_playing(!playing);
slider.max = last;
slider.oninput = () => { set_playing(false); at = +slider.value; draw(); };
if (!flat) {
  canvas.style.cursor = 'grab';
  canvas.onpointerdown = e => canvas.setPointerCapture(e.pointerId);
  canvas.onpointermove = e => {
    if (!e.buttons) return;
    azimuth -= e.movementX * 0.01;
    elevation = Math.max(-1.55, Math.min(1.55, elevation + e.movementY * 0.01));
    turn(); fit(); draw();
  };
}
window.addEventListener('resize', () => { canvas.style.height = ''; fit(); draw(); });
if (location.hash) at = Math.min(last, Math.max(0, parseInt(location.hash.slice(1)) || 0));
fit(); draw();
})();
</script>
)html";

/// A number of at most six digits, so that the file stays small; null for none.
Json short_number(double value) {
  if (!std::isfinite(value)) return nullptr;
  return std::stod(fmt::format("{:.6g}", value));
}

std::vector<double> in_millimetres(const Eigen::VectorXd& x) {
  const Eigen::VectorXd mm = x / kMillimetre;
  return {mm.begin(), mm.end()};
}

/// One entry for each item of a list.
template <class List, class Make>
Json array_of(const List& list, Make&& make) {
  Json array = Json::array();
  for (const auto& item : list) array.push_back(make(item));
  return array;
}

/// Coordinates of points [mm], one after the other.
Json short_coordinates(const std::vector<Eigen::VectorXd>& points) {
  Json array = Json::array();
  for (const Eigen::VectorXd& point : points) {
    for (const double value : point) array.push_back(short_number(value / kMillimetre));
  }
  return array;
}

/// Whole steps of all points of a frame from the window's lower corner.
std::vector<int> steps_of(const SimulationRecord& record, const plot::Surface& surface, const plot::Bounds& bounds,
                          double step, size_t frame) {
  std::vector<int> steps;
  const auto add = [&](const Eigen::MatrixXd& x) {
    for (const auto& point : x.colwise()) {
      for (Eigen::Index c = 0; c < x.rows(); ++c) {
        steps.push_back(static_cast<int>(std::lround((point[c] - bounds.lower[c]) / step)));
      }
    }
  };
  add(plot::positions(surface, record.mesh, record.states[frame]));
  for (const DrawnLine& line : record.lines) add(plot::positions(line, record.mesh, record.states[frame]));
  return steps;
}

std::string frames_text(const std::vector<std::vector<int>>& steps, const std::vector<size_t>& chosen) {
  std::string text = "[";
  for (size_t f = 0; f < chosen.size(); ++f) {
    text += f == 0 ? "[" : ",\n[";
    const std::vector<int>& now = steps[chosen[f]];
    for (size_t i = 0; i < now.size(); ++i) {
      fmt::format_to(std::back_inserter(text), "{}{}", i == 0 ? "" : ",",
                     f == 0 ? now[i] : now[i] - steps[chosen[f - 1]][i]);
    }
    text += "]";
  }
  return text + "]";
}

/// The frames' positions as text of at most `budget` bytes, and which frames they are.
std::pair<std::string, std::vector<size_t>> frames_within(size_t budget, const std::vector<std::vector<int>>& steps) {
  std::vector<size_t> chosen = plot::evenly_chosen(steps.size(), steps.size());
  std::string frames = frames_text(steps, chosen);
  while (frames.size() > budget && chosen.size() > 2) {
    const double kept = std::min(0.9, static_cast<double>(budget) / static_cast<double>(frames.size()));
    chosen = plot::evenly_chosen(steps.size(),
                                 std::max<size_t>(2, static_cast<size_t>(kept * static_cast<double>(chosen.size()))));
    frames = frames_text(steps, chosen);
  }
  return {frames, chosen};
}

/// What is drawn in every frame, and in which colours.
Json scene_json(const SimulationRecord& record, const plot::Surface& surface, const plot::Bounds& bounds, double step,
                const std::vector<size_t>& chosen) {
  Json json{{"dimension", record.mesh.dimension()},
            {"window", {{"lower", in_millimetres(bounds.lower)}, {"upper", in_millimetres(bounds.upper)}}},
            {"step", step / kMillimetre},
            {"regions", Json::array()},
            {"nodes", surface.nodes}};
  for (const std::string& name : record.mesh.region_names)
    json["regions"].push_back({{"name", name}, {"colour", plot::body_colour(name, json["regions"].size())}});
  json["loops"] = array_of(surface.loops, [](const plot::Surface::Loop& loop) {
    return Json{{"region", loop.region}, {"points", loop.points}};
  });
  json["triangles"] = json["triangle_regions"] = Json::array();
  for (const auto& [region, points] : surface.triangles) {
    for (const int point : points) json["triangles"].push_back(point);
    json["triangle_regions"].push_back(region);
  }
  json["lines"] = Json::array();
  const size_t count = record.lines.size();
  for (size_t i = 0; i < count; ++i) {
    const std::string name = plot::lines_are_told_apart(count) ? record.lines[i].id : i == 0 ? "cables" : "";
    json["lines"].push_back(
        {{"name", name}, {"colour", plot::line_colour(i, count)}, {"count", record.lines[i].points.size()}});
  }
  json["obstacles"] = array_of(record.obstacles, short_coordinates);
  using plot::GroundsDrawn;
  for (const auto& [name, which] :
       {std::pair("ground", GroundsDrawn::planes), std::pair("round", GroundsDrawn::round)}) {
    json[name] = Json::array();
    for (size_t frame : plot::grounds_move(record) ? chosen : std::vector<size_t>{0}) {
      std::vector<Eigen::VectorXd> strokes;
      for (const auto& [from, to] : plot::ground_strokes(record, bounds, frame, which))
        strokes.insert(strokes.end(), {from, to});
      json[name].push_back(short_coordinates(strokes));
    }
  }
  return json;
}

/// The sample variable and the series in the chosen frames.
void add_values(Json& json, const SimulationRecord& record, const std::vector<size_t>& chosen) {
  const auto in_frames = [&](const std::vector<double>& values, double unit) {
    return array_of(
        chosen, [&](size_t frame) { return short_number(values[static_cast<size_t>(record.frames[frame])] / unit); });
  };
  const SampleLabel label(record);
  json["sample"] = {{"name", record.sample_name},
                    {"unit", label.unit().label},
                    {"decimals", label.decimals()},
                    {"seconds", record.sample_unit == "s" ? label.unit().factor : 0.0},
                    {"values", in_frames(record.samples, label.unit().factor)}};
  json["series"] = array_of(all_series(record), [&](const Series* series) {
    const WrittenUnit unit = shown_unit(series->unit, series->values);
    const bool control = series >= record.controls.data() && series < record.controls.data() + record.controls.size();
    return Json{{"id", series->id},
                {"meaning", series->meaning},
                {"unit", unit.label},
                {"control", control},
                {"values", in_frames(series->values, unit.factor)}};
  });
}

}  // namespace

std::string animation_json(const SimulationRecord& record, size_t budget) {
  const plot::Surface surface = plot::surface_of(record.mesh);
  const plot::Bounds bounds = plot::bounds_of(record);
  const double step = (bounds.upper - bounds.lower).maxCoeff() / kSteps;
  std::vector<std::vector<int>> steps;
  for (size_t f = 0; f < record.states.size(); ++f) steps.push_back(steps_of(record, surface, bounds, step, f));
  const auto [frames, chosen] = frames_within(budget, steps);

  Json json = scene_json(record, surface, bounds, step, chosen);
  add_values(json, record, chosen);
  json["shown"] = chosen.size();
  json["stored"] = record.states.size();
  std::string text = json.dump(-1, ' ', false, Json::error_handler_t::replace);
  text.pop_back();
  text += ",\"frames\":" + frames + "}";
  // Text must not end the script element.
  for (size_t at = text.find('<'); at != std::string::npos; at = text.find('<', at)) text.replace(at, 1, "\\u003c");
  return text;
}

std::string animation_fragment(const SimulationRecord& record) {
  std::string text = kFragment;
  const std::string mark = "@DATA@";
  return text.replace(text.find(mark), mark.size(), animation_json(record));
}

std::string animation_html(const SimulationRecord& record) {
  return html::page("Simulation: " + record.title,
                    fmt::format("<h1>Simulation: {}</h1>\n<p>{}</p>\n{}", html::escaped(record.title),
                                html::escaped(record.description), animation_fragment(record)));
}

}  // namespace taut
