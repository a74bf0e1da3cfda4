"use strict";
(function () {
  // Tables: a click on a heading sorts, another click turns the order round; cells without a number come last.
  document.querySelectorAll("table.sortable").forEach(function (table) {
    var headings = Array.from(table.tHead.rows[0].cells);
    headings.forEach(function (heading, column) {
      heading.firstElementChild.addEventListener("click", function () {
        var order = heading.getAttribute("aria-sort") === "ascending" ? "descending" : "ascending";
        headings.forEach(function (each) { each.removeAttribute("aria-sort"); });
        heading.setAttribute("aria-sort", order);
        var sign = order === "ascending" ? 1 : -1, numbers = heading.classList.contains("number");
        var rows = Array.from(table.tBodies[0].rows).map(function (row) {
          var cell = row.cells[column], value = cell.dataset.value;
          return { row: row, text: cell.textContent, number: value === undefined ? null : Number(value) };
        });
        rows.sort(function (a, b) {
          if (!numbers) return sign * a.text.localeCompare(b.text, "en", { numeric: true });
          if (a.number === null || b.number === null) return (a.number === null) - (b.number === null);
          return sign * (a.number - b.number);
        });
        rows.forEach(function (each) { table.tBodies[0].appendChild(each.row); });
      });
    });
  });

  if (window.matchMedia("(max-width: 60rem)").matches) document.querySelector("nav details").open = false;

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
    switches.forEach(function (each) { visible[each.dataset.node] = each.checked; });
    scene.frames.forEach(function (nodes, index) {
      nodes.forEach(function (node) { visible[node] = index === current; });
    });
    send({ visible: visible });
  }
  function go(index) {
    current = index;
    time.value = index;
    document.getElementById("scene-now").textContent = index + 1 + " of " + scene.frames.length;
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
