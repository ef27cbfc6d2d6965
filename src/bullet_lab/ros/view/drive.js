// The drive pad and the arrow keys. While one is held, a command is sent ten times a second on a
// separate socket: the newest time received from the server, then shares of the full speed forward
// and to the left. The server stops the robot if that time is too old.
(() => {
  const PERIOD_MS = 100;
  const RETRY_MS = 1000;
  const RADIUS = 55;
  const KEYS = { ArrowUp: [1, 0], ArrowDown: [-1, 0], ArrowLeft: [0, 1], ArrowRight: [0, -1] };
  const HINTS = {
    free: "Drag, or hold the arrow keys, to drive",
    other: "Another page drives. Click here to take over",
    late: "The link is too slow to drive",
  };
  const { nonce, dataset } = document.currentScript;
  const held = new Set();
  let pulled = [0, 0];
  let sent = "0 0";
  let socket = null;
  let state = { time: 0, other: false, late: false };

  // Each tab has a name, in the path of viser's socket and of this one.
  const [token] = location.pathname.split("/").filter(Boolean);
  history.replaceState(null, "", `/${token}/${dataset.tab}/`);
  const address = location.href.replace(/^http/, "ws").split(/[?#]/)[0] + "drive";

  // viser adds one script, and styles, without the nonce that the policy requires.
  const create = document.createElement;
  let scripts = 1;
  document.createElement = function (name, options) {
    const element = create.call(this, name, options);
    const kind = element.localName;
    if (kind === "style" || (kind === "script" && scripts-- > 0)) element.nonce = nonce;
    return element;
  };

  const pad = document.createElement("div");
  const knob = document.createElement("div");
  pad.id = "drive-pad";
  const hint = document.createElement("div");
  pad.style.cssText =
    "position:fixed;left:16px;bottom:16px;width:130px;height:130px;z-index:5;" +
    "border-radius:50%;background:rgba(60,70,80,.28);touch-action:none;cursor:grab;";
  knob.style.cssText =
    "position:absolute;left:40px;top:40px;width:50px;height:50px;border-radius:50%;" +
    "background:rgba(0,114,178,.85);pointer-events:none;";
  hint.style.cssText =
    "position:absolute;left:140px;bottom:8px;width:180px;font:13px sans-serif;" +
    "pointer-events:none;";
  pad.append(knob, hint);

  const show = () => {
    const kind = state.other ? "other" : state.late ? "late" : "free";
    pad.title = HINTS[kind];
    pad.dataset.state = kind;
    hint.textContent = kind === "free" ? "" : HINTS[kind];
    knob.style.opacity = kind === "other" ? 0.3 : 1;
  };

  const wanted = () => {
    let [forward, left] = pulled;
    for (const key of held) {
      forward += KEYS[key][0];
      left += KEYS[key][1];
    }
    return [forward, left].map((share) => Math.max(-1, Math.min(1, share)));
  };

  const send = () => {
    const [forward, left] = wanted();
    const shares = `${forward.toFixed(3) / 1} ${left.toFixed(3) / 1}`;
    knob.style.transform = `translate(${-left * RADIUS}px, ${-forward * RADIUS}px)`;
    if (socket === null || socket.readyState !== WebSocket.OPEN) return;
    if (shares === sent && shares === "0 0") return;
    socket.send(`${state.time} ${shares}`);
    sent = shares;
  };

  const letGo = () => {
    held.clear();
    pulled = [0, 0];
    send();
  };

  const pull = (event) => {
    const box = pad.getBoundingClientRect();
    const left = (box.left + box.width / 2 - event.clientX) / RADIUS;
    const forward = (box.top + box.height / 2 - event.clientY) / RADIUS;
    const scale = Math.max(1, Math.hypot(forward, left));
    pulled = [forward / scale, left / scale];
    send();
  };

  pad.addEventListener("pointerdown", (event) => {
    if (state.other) {
      socket.send("take over");
      return;
    }
    pad.setPointerCapture(event.pointerId);
    pull(event);
  });
  pad.addEventListener("pointermove", (event) => {
    if (pad.hasPointerCapture(event.pointerId)) pull(event);
  });
  for (const name of ["pointerup", "pointercancel", "lostpointercapture"]) {
    pad.addEventListener(name, letGo);
  }

  // Whether an element takes text, or moves with the same keys.
  const isTaken = (target) =>
    target instanceof Element &&
    target.closest("input, textarea, select, [role=slider], [contenteditable=true]") !== null;

  // Captured before the page's own listeners, which would move the camera.
  window.addEventListener(
    "keydown",
    (event) => {
      const other = event.ctrlKey || event.altKey || event.metaKey;
      if (!(event.key in KEYS) || other || isTaken(event.target)) return;
      event.preventDefault();
      event.stopImmediatePropagation();
      held.add(event.key);
      send();
    },
    true,
  );
  window.addEventListener(
    "keyup",
    (event) => {
      if (held.delete(event.key)) send();
    },
    true,
  );
  window.addEventListener("blur", letGo);
  document.addEventListener("visibilitychange", letGo);

  const connect = () => {
    socket = new WebSocket(address);
    socket.addEventListener("open", () => {
      sent = "0 0";
      pad.style.opacity = 1;
    });
    socket.addEventListener("message", (event) => {
      state = JSON.parse(event.data);
      show();
    });
    socket.addEventListener("close", () => {
      pad.style.opacity = 0.3;
      setTimeout(connect, RETRY_MS);
    });
  };

  document.addEventListener("DOMContentLoaded", () => {
    document.body.append(pad);
    connect();
    setInterval(send, PERIOD_MS);
  });
})();
