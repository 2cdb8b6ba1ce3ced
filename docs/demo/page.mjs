// The arm on the page "Out of Python": a target to move, inverse kinematics and link frames in WebAssembly.
const place = document.getElementById("arm-demo");
const SLIDERS = { x: [-0.8, 0.8, 0.4], y: [-0.8, 0.8, 0.2], z: [0, 0.9, 0.4] };

async function begin() {
  const modules = await Promise.all(["arm_frames", "arm_ik"].map((name) => import(new URL(`./${name}.mjs`, import.meta.url))));
  const arm = Object.assign({}, ...(await Promise.all(modules.map((each) => each.load()))));
  const canvas = place.appendChild(Object.assign(document.createElement("canvas"), { width: 640, height: 320 }));
  const told = place.appendChild(document.createElement("p"));
  const values = {};
  for (const [name, [min, max, value]] of Object.entries(SLIDERS)) {
    const label = place.appendChild(Object.assign(document.createElement("label"), { textContent: `${name} ` }));
    const slider = Object.assign(document.createElement("input"), { type: "range", min, max, step: 0.005 });
    slider.value = values[name] = value;
    slider.addEventListener("input", () => ((values[name] = Number(slider.value)), show()));
    label.appendChild(slider);
  }
  let posture = new Float64Array(6);
  function show() {
    const { x, y, z } = values; // the tool points down
    const start = performance.now();
    const found = arm.arm_ik({ pose: [1, 0, 0, x, 0, -1, 0, y, 0, 0, -1, z, 0, 0, 0, 1] });
    const spent = 1e3 * (performance.now() - start);
    if (found.reason[0] === 0) posture = found.q;
    told.textContent = found.reason[0] === 0 ? `q = ${[...posture].map((a) => a.toFixed(3)).join(", ")} rad; ${spent.toFixed(0)} us` : "out of reach";
    draw(canvas.getContext("2d"), arm.arm_frames({ q: posture }).frames, [x, y, z]);
  }
  show();
}

// From the front and from above: the places of the frames, and the target.
function draw(to, frames, target) {
  const { width, height } = to.canvas;
  to.clearRect(0, 0, width, height);
  for (const [view, across, up] of [[0, 1, 2], [1, 1, 0]]) {
    const at = (p) => [width * (0.25 + 0.5 * view) + 140 * p[across], height * (view ? 0.5 : 0.85) - 140 * p[up]];
    to.beginPath();
    for (let k = 0; k < frames.length; k += 16) to.lineTo(...at([frames[k + 3], frames[k + 7], frames[k + 11]]));
    to.lineWidth = 6;
    to.lineJoin = "round";
    to.strokeStyle = "#009688";
    to.stroke();
    to.beginPath();
    to.arc(...at(target), 6, 0, 7);
    to.fillStyle = "#d84315";
    to.fill();
  }
}

if (place) begin().catch(() => (place.textContent = "The demo is not there: it is made where WebAssembly's linker is installed."));
