// The viewer reads what it is sent, and what a pressed pointer does, once a frame. That is late where software draws
// the frames, so both are read as they come.
const Plain = Worker;
window.Worker = class extends Plain {
  constructor(...given) {
    super(...given);
    this.addEventListener("message", () => setTimeout(() => window.__viserMutable?.drainMessageQueue?.()));
  }
};
let last = "";
const place = (event) => `${event.clientX} ${event.clientY}`;
addEventListener("pointerrawupdate", (event) => {
  if (!event.buttons) return;
  last = place(event);
  event.target.dispatchEvent(new PointerEvent("pointermove", event));
}, true);
addEventListener("pointermove", (event) => {
  if (event.isTrusted && event.buttons && place(event) === last) event.stopImmediatePropagation();
}, true);
