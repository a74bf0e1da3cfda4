// viser prepares to sort splats, of which there are none here, by code made from text, which the page forbids.
addEventListener("unhandledrejection", function (event) {
  if (event.reason instanceof EvalError) event.preventDefault();
});
addEventListener("message", function (event) {
  if (event.source !== parent || !event.data || !event.data.scene) return;
  var asked = event.data.scene, viewer = window.__viserMutable;
  if (asked.reset) { viewer.resetCameraPose(true); return; }
  Object.keys(asked.visible).forEach(function (name) {
    viewer.messageQueue.push(
      {type: "SetSceneNodeVisibilityMessage", name: name, owner: "", visible: asked.visible[name]});
  });
  viewer.requestRender();
});
var waiting = setInterval(function () {
  var viewer = window.__viserMutable;
  if (!viewer || !viewer.nodeRefFromName || !viewer.nodeRefFromName["/end"]) return;
  clearInterval(waiting);
  parent.postMessage({scene: {ready: true}}, "*");
}, 50);
