// The viewer reads what it is sent, and what a pressed pointer does, once a frame. That is late where software draws
// the frames, so both are read as they come.
const Plain = Worker;
window.Worker = class extends Plain {
  constructor(...given) {
    super(...given);
    this.addEventListener("message", () => setTimeout(() => {
      const viewer = window.__viserMutable;
      viewer?.drainMessageQueue?.();
      if (viewer?.backgroundMaterial) viewer.backgroundMaterial.visible = false; // there is no picture in it
    }));
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

// Where software draws, a frame takes less than half the time without antialiasing, gloss and an empty background.
// While the pointer is pressed fewer frames are drawn, as they take the processor from those who answer a drag.
const probe = document.createElement("canvas").getContext("webgl2");
const info = probe?.getExtension("WEBGL_debug_renderer_info");
if (info && /swiftshader|llvmpipe/i.test(probe.getParameter(info.UNMASKED_RENDERER_WEBGL))) {
  const alter = (owner, name, change) => {
    const call = owner.prototype[name];
    owner.prototype[name] = function (first, second) {
      return call.call(this, first, change(second));
    };
  };
  alter(HTMLCanvasElement, "getContext", (asked) => asked && { ...asked, antialias: false });
  alter(WebGL2RenderingContext, "shaderSource", (text) => {
    const plain = !/#define USE_(MAP|COLOR)/.test(text) && text.includes("directionalLights[ 1 ]");
    if (!plain || !/pc_fragColor[^]*SHADER_TYPE MeshStandardMaterial/.test(text)) return text;
    return `${text.slice(0, text.indexOf("void main() {"))}void main() {
      #ifdef FLAT_SHADED
        vec3 normal = normalize(cross(dFdx(vViewPosition), dFdy(vViewPosition)));
      #else
        vec3 normal = normalize(vNormal);
      #endif
      vec3 light = ambientLightColor
        + saturate(dot(normal, directionalLights[0].direction)) * directionalLights[0].color;
      gl_FragColor = sRGBTransferOETF(vec4(toneMapping(0.98 * RECIPROCAL_PI * diffuse * light), opacity));
    }`;
  });
  const ask = requestAnimationFrame, drop = cancelAnimationFrame, asked = new Map();
  let pressed = false, drawn = 0, count = 0;
  for (const kind of ["pointerdown", "pointerup"]) addEventListener(kind, () => pressed = kind === "pointerdown", true);
  window.requestAnimationFrame = (draw) => {
    const own = ++count, wait = (time) => {
      if (pressed && time > drawn && time < drawn + 150) return asked.set(own, ask(wait));
      asked.delete(own);
      drawn = time;
      draw(time);
    };
    asked.set(own, ask(wait));
    return own;
  };
  window.cancelAnimationFrame = (own) => {
    drop(asked.get(own));
    asked.delete(own);
  };
}
