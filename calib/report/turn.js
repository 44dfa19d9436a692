// The array in three dimensions: a parallel projection that pointer, buttons and arrow keys turn.
"use strict";
(() => {
  const scene = JSON.parse(document.getElementById("scene-data").textContent);
  const stage = document.getElementById("scene");
  const picture = stage.querySelector("svg");
  const factor = document.getElementById("exaggeration");
  const withBoards = document.getElementById("with-boards");
  const WIDTH = 960, HEIGHT = 560, MARGIN = 60, STEP = Math.PI / 24, AXIS_M = 0.12;
  const VIEWS = {start: [0.72, 0.4], front: [0, 0], above: [0, Math.PI / 2], side: [-Math.PI / 2, 0]};
  const points = [[0, 0, 0], ...scene.microphones.map(m => m.at), ...scene.boards.flatMap(b => b.rim)];
  const view = {yaw: VIEWS.start[0], pitch: VIEWS.start[1], zoom: 1};

  // The rows of the rotation are the picture's right, the picture's down, and into the picture.
  const rotation = () => {
    const [c, s, d, t] = [Math.cos(view.yaw), Math.sin(view.yaw), Math.cos(view.pitch), Math.sin(view.pitch)];
    return [[c, 0, s], [s * t, d, -c * t], [-s * d, t, c * d]];
  };
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  function span(row) {
    const values = points.map(point => dot(row, point));
    const [low, high] = [Math.min(...values), Math.max(...values)];
    return {middle: (low + high) / 2, length: high - low};
  }

  function draw() {
    const turn = rotation(), across = span(turn[0]), along = span(turn[1]);
    const scale = view.zoom * Math.min((WIDTH - 2 * MARGIN) / across.length, (HEIGHT - 2 * MARGIN) / along.length);
    const place = point => [
      WIDTH / 2 + scale * (dot(turn[0], point) - across.middle),
      HEIGHT / 2 + scale * (dot(turn[1], point) - along.middle),
    ];
    const depth = point => dot(turn[2], point);
    const path = corners => corners.map(corner => place(corner).map(v => v.toFixed(1)).join(",")).join(" ");
    const parts = [];
    if (withBoards.checked) {
      const boards = scene.boards.map(board => ({...board, depth: depth(board.rim[0])}));
      boards.sort((a, b) => b.depth - a.depth).forEach((board, order) => {
        const strength = (0.35 + 0.65 * order / boards.length).toFixed(2);
        parts.push(`<polygon class="board" opacity="${strength}" points="${path(board.rim)}">` +
          `<title>board position ${board.pose}</title></polygon>`);
      });
    }
    const far = scene.frustum;
    far.forEach((corner, i) => parts.push(
      `<polygon class="frustum" points="${path([[0, 0, 0], corner, far[(i + 1) % 4]])}"></polygon>`));
    ["x", "y", "z"].forEach((name, axis) => {
      const [x, y] = place([0, 0, 0]), [u, v] = place([0, 1, 2].map(i => i === axis ? AXIS_M : 0));
      if (Math.hypot(u - x, v - y) < 8) return;
      parts.push(`<line class="axis" x1="${x}" y1="${y}" x2="${u}" y2="${v}"></line>` +
        `<text class="axis" x="${u + 4}" y="${v + 4}">${name}</text>`);
    });
    scene.microphones.map(m => ({...m, depth: depth(m.at)})).sort((a, b) => b.depth - a.depth)
      .forEach(microphone => parts.push(drawn(microphone, turn, scale, place)));
    picture.innerHTML = parts.join("");
  }

  // The outline of an ellipsoid in a parallel projection is the ellipse of the projected covariance.
  function drawn(microphone, turn, scale, place) {
    const [x, y] = place(microphone.at);
    const times = microphone.covariance.map(row => [dot(row, turn[0]), dot(row, turn[1])]);
    const column = i => times.map(row => row[i]);
    const a = dot(turn[0], column(0)), b = dot(turn[0], column(1)), c = dot(turn[1], column(1));
    const half = (a + c) / 2, root = Math.sqrt(((a - c) / 2) ** 2 + b * b);
    const size = scene.sigmas * scale * Number(factor.value);
    const axes = [half + root, half - root].map(value => size * Math.sqrt(Math.max(value, 0)));
    const angle = Math.atan2(half + root - a, b || 1e-30) * 180 / Math.PI;
    return `<g class="microphone"><title>channel ${microphone.channel}, ± ${microphone.std_mm} mm</title>` +
      `<ellipse cx="${x}" cy="${y}" rx="${axes[0]}" ry="${axes[1]}" transform="rotate(${angle} ${x} ${y})"></ellipse>` +
      `<circle cx="${x}" cy="${y}" r="3.5"></circle><text x="${x + 9}" y="${y - 8}">${microphone.channel}</text></g>`;
  }

  const limit = (value, reach) => Math.max(-reach, Math.min(reach, value));
  function turned(yaw, pitch, zoom = 1) {
    view.yaw += yaw;
    view.pitch = limit(view.pitch + pitch, Math.PI / 2);
    view.zoom = Math.max(0.5, Math.min(8, view.zoom * zoom));
    draw();
  }
  const ACTIONS = {
    left: () => turned(STEP, 0), right: () => turned(-STEP, 0), up: () => turned(0, -STEP), down: () => turned(0, STEP),
    nearer: () => turned(0, 0, 1.25), farther: () => turned(0, 0, 0.8),
  };
  Object.entries(VIEWS).forEach(([name, [yaw, pitch]]) => {
    ACTIONS[name] = () => { Object.assign(view, {yaw, pitch, zoom: 1}); draw(); };
  });
  const KEYS = {ArrowLeft: "left", ArrowRight: "right", ArrowUp: "up", ArrowDown: "down", "+": "nearer", "-": "farther", Home: "start"};

  document.querySelectorAll("[data-turn]").forEach(button =>
    button.addEventListener("click", () => ACTIONS[button.dataset.turn]()));
  stage.addEventListener("keydown", event => {
    if (!(event.key in KEYS) || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    ACTIONS[KEYS[event.key]]();
  });
  stage.addEventListener("pointerdown", event => stage.setPointerCapture(event.pointerId));
  stage.addEventListener("pointermove", event => {
    if (stage.hasPointerCapture(event.pointerId)) turned(-event.movementX / 150, event.movementY / 150);
  });
  [factor, withBoards].forEach(control => control.addEventListener("change", draw));
  document.documentElement.classList.add("turning");
  draw();
})();
