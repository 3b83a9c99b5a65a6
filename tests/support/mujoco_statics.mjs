// Loads a file in MuJoCo, applies forces one after the other, and prints where the watched point has come to rest:
//   node mujoco_statics.mjs PACKAGE_FOLDER STATES.json STATE FORCE...
// STATES.json is what `taut export` writes beside its files. A URDF gets the hinges' stiffness from there, as its readers
// have to; the force is then put on the body at the point of the load.
import fs from 'fs';
import path from 'path';
import {pathToFileURL} from 'url';

const [folder, states, index, ...forces] = process.argv.slice(2);
const {default: load} = await import(pathToFileURL(path.join(folder, 'mujoco-js/dist/mujoco_wasm.js')).href);
const mujoco = await load();
const state = JSON.parse(fs.readFileSync(states, 'utf8')).states[Number(index)];
const file = path.join(path.dirname(states), state.file);
mujoco.FS.mkdir('/model');
mujoco.FS.writeFile('/model/' + state.file, fs.readFileSync(file, 'utf8'));
const model = mujoco.MjModel.loadFromXML('/model/' + state.file);
const data = new mujoco.MjData(model);
const urdf = state.file.endsWith('.urdf');
if (urdf) {
  for (let j = 0; j < model.njnt; ++j) model.jnt_stiffness[j] = state.hinge_stiffness_Nm_per_rad;
  for (let k = 0; k < 3; ++k) model.opt.gravity[k] = state.gravity_m_per_s2[k];
  model.opt.timestep = Math.min(1e-3, 0.3 / (2 * Math.PI * state.modes_Hz[1]));
  model.opt.integrator = 3;  // mjINT_IMPLICITFAST
}
mujoco.mj_forward(model, data);

/// A point of a segment: the segments' bodies are turned by nothing at rest.
function fixed_to(place) {
  const body = model.nbody - 1 - (state.segments.length - 1 - place.segment);
  const own = [0, 1, 2].map(k => place.at_m[k] - data.xpos[3 * body + k]);
  return {body, at: () => [0, 1, 2].map(k => data.xpos[3 * body + k] + own.reduce((s, v, c) => s + data.xmat[9 * body + 3 * k + c] * v, 0))};
}
const pushed = fixed_to(state.load_at), watched = fixed_to(state.watched_at);
const place = () => urdf ? watched.at() : Array.from(data.sensordata).slice(0, 3);
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];

/// Steps until nothing moves.
function settle(force) {
  let steps = 0;
  for (let still = 0; still < 200 && steps < 4e6; ++steps) {
    if (urdf) {
      const newtons = state.load_direction.map(v => v * force), at = pushed.at();
      const arm = at.map((v, k) => v - data.xipos[3 * pushed.body + k]), torque = cross(arm, newtons);
      for (let k = 0; k < 3; ++k) {
        data.xfrc_applied[6 * pushed.body + k] = newtons[k];
        data.xfrc_applied[6 * pushed.body + 3 + k] = torque[k];
      }
    } else {
      data.ctrl[0] = force;
    }
    mujoco.mj_step(model, data);
    let fastest = 0;
    for (let j = 0; j < model.nv; ++j) fastest = Math.max(fastest, Math.abs(data.qvel[j]));
    still = fastest < 1e-8 ? still + 1 : 0;
  }
  return {steps, at: place()};
}

const rest = settle(0);
const moved = forces.map(Number).map(force => {
  const {steps, at} = settle(force);
  return {force, steps, displacement: state.watched_direction.reduce((s, v, k) => s + v * (at[k] - rest.at[k]), 0)};
});
console.log(JSON.stringify({version: mujoco.mj_versionString(), hinges: model.njnt, rest: rest.at, moved}));
