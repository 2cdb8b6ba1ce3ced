// Exported functions in WebAssembly beside numbers of this machine's: at most 4 units in the last place apart.
import assert from "node:assert";
import { readFile } from "node:fs/promises";
import { pathToFileURL } from "node:url";

const folder = process.argv[2];
const { load } = await import(pathToFileURL(`${folder}/robot.mjs`));
const robot = await load(await readFile(`${folder}/robot.wasm`));
const numbers = JSON.parse(await readFile(`${folder}/numbers.json`));

const ordered = (x) => {
  const bits = new Int32Array(new Float32Array([x]).buffer)[0];
  return bits < 0 ? -0x80000000 - bits : bits;
};
for (const [name, [given, wanted]] of Object.entries(numbers)) {
  const found = robot[name](given);
  let most = 0;
  for (const [result, values] of Object.entries(wanted)) {
    assert.equal(found[result].length, values.length);
    values.forEach((x, i) => (most = Math.max(most, Math.abs(ordered(x) - ordered(found[result][i])))));
  }
  console.log(`${name}: at most ${most} ulp apart`);
  assert(most <= 4);
}
assert.throws(() => robot.robot_clearance({ q: [1, 2] }), /q has 2 numbers/);

// the demo of the documentation: the frames of its answer end at the pose that was asked
const arm = {};
for (const name of ["arm_frames", "arm_ik"]) {
  const demo = await import(pathToFileURL(`${folder}/../demo/${name}.mjs`));
  Object.assign(arm, await demo.load(await readFile(`${folder}/../demo/${name}.wasm`)));
}
const pose = [1, 0, 0, 0.4, 0, -1, 0, 0.2, 0, 0, -1, 0.4, 0, 0, 0, 1];
const { q, reason } = arm.arm_ik({ pose });
const tip = arm.arm_frames({ q }).frames.slice(-16);
assert.equal(reason[0], 0);
pose.forEach((x, i) => assert(Math.abs(x - tip[i]) < 1e-6));
pose[3] = 3;
assert.notEqual(arm.arm_ik({ pose }).reason[0], 0);
