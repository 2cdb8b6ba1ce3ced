// The arm on the page "Out of Python": a target to move, inverse kinematics and link frames in WebAssembly.
const place = document.getElementById("arm-demo");
const REASONS = { 1: "out of reach", 3: "there the arm would touch itself", 4: "no posture was found" };
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
    const number = Object.assign(document.createElement("output"), { textContent: ` ${value.toFixed(3)} m ` });
    slider.addEventListener("input", () => (number.textContent = ` ${values[name].toFixed(3)} m `));
    label.append(slider, number);
  }
  let posture = new Float64Array(6);
  function show() {
    const { x, y, z } = values; // the tool points down
    const start = performance.now();
    const found = arm.arm_ik({ pose: [1, 0, 0, x, 0, -1, 0, y, 0, 0, -1, z, 0, 0, 0, 1] });
    const spent = 1e3 * (performance.now() - start);
    const solved = found.reason[0] === 0;
    if (solved) posture = found.q;
    place.dataset.posture = solved ? [...posture].join(" ") : "";
    told.textContent = solved
      ? `q = ${[...posture].map((a) => a.toFixed(3)).join(", ")} rad; ${spent.toFixed(0)} us`
      : `${REASONS[found.reason[0]]}; ${spent.toFixed(0)} us`;
    draw(canvas.getContext("2d"), arm.arm_frames({ q: posture }).frames, [x, y, z]);
  }
  show();
}

const VIEWS = [["from the front", 1, 2], ["from above", 1, 0]]; // the axes that go across and up

// The places of the frames, and the target.
function draw(to, frames, target) {
  const { width, height } = to.canvas;
  to.clearRect(0, 0, width, height);
  to.font = "14px sans-serif";
  for (const [view, [words, across, up]] of VIEWS.entries()) {
    to.fillStyle = getComputedStyle(to.canvas).color;
    to.fillText(words, width * (0.02 + 0.5 * view), 18);
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
