"use strict";
(function () {
  // The scene: written into its frame when the reader comes near, then switched by messages.
  var data = document.getElementById("scene-data"), frame = document.getElementById("scene-frame");
  if (!data || !frame) return;
  var probe = document.createElement("canvas");
  if (!(probe.getContext("webgl2") || probe.getContext("webgl"))) {
    document.getElementById("scene-trouble").hidden = false;
    document.querySelector(".view").hidden = true;
    document.querySelector(".controls").hidden = true;
    return;
  }
  var scene = null, current = 0, timer = null;
  var switches = Array.from(document.querySelectorAll("#scene input[data-node]"));
  var time = document.getElementById("scene-time"), play = document.getElementById("scene-play");

  function send(message) { if (frame.contentWindow) frame.contentWindow.postMessage({ scene: message }, "*"); }
  function show() {
    var visible = {};
    switches.forEach(function (each) {
      each.dataset.node.split(" ").forEach(function (node) { visible[node] = each.checked; });
    });
    scene.frames.forEach(function (nodes, index) {
      nodes.forEach(function (node) { visible[node] = index === current; });
    });
    send({ visible: visible });
  }
  function go(index) {
    current = index;
    time.value = index;
    document.getElementById("scene-now").textContent =
      index + 1 + " of " + scene.frames.length + (scene.names ? " · " + scene.names[index] : "");
    show();
  }
  function load() {
    scene = JSON.parse(data.textContent);
    data.remove();
    frame.srcdoc = scene.html;
  }
  window.addEventListener("message", function (event) {
    if (event.source !== frame.contentWindow || !event.data.scene || !event.data.scene.ready) return;
    document.getElementById("scene-wait").hidden = true;
    document.getElementById("scene").dataset.ready = "yes";
    show();
  });
  switches.forEach(function (each) { each.addEventListener("change", function () { if (scene) show(); }); });
  document.getElementById("scene-reset").addEventListener("click", function () { send({ reset: true }); });
  if (play) {
    play.addEventListener("click", function () {
      var playing = timer === null;
      if (playing) timer = setInterval(function () { if (scene) go((current + 1) % scene.frames.length); }, 400);
      else { clearInterval(timer); timer = null; }
      play.setAttribute("aria-pressed", String(playing));
      play.textContent = playing ? "Pause" : "Play";
    });
    time.addEventListener("input", function () { if (scene) go(Number(time.value)); });
  }
  if (!("IntersectionObserver" in window)) load();
  else {
    var watch = new IntersectionObserver(function (entries) {
      if (entries.some(function (each) { return each.isIntersecting; })) { watch.disconnect(); load(); }
    }, { rootMargin: "300px" });
    watch.observe(frame);
  }
})();
