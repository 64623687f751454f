// Puts the parts together and draws.

import { setUpAgenda } from "./agenda.js";
import { call } from "./api.js";
import { setUpCharacters } from "./characters.js";
import { setUpCharts } from "./charts.js";
import { makeSteering, pickLimb, pointFor, sendTarget, setUpCommands, setUpTargetForm } from "./command.js";
import { setUpDeeds } from "./deeds.js";
import { attempt, byId, toast } from "./dom.js";
import { offeredFormats, setUpEpisodes } from "./episodes.js";
import { Ghost } from "./ghost.js";
import { KeyFigures } from "./keyfigure.js";
import { setUpKeys } from "./keys.js";
import { bodyShapes, Mannequin } from "./mannequin.js";
import { PushArrow, TargetMarker } from "./marker.js";
import { setUpNow } from "./now.js";
import { SceneObjects } from "./objects.js";
import { onScreen, Pointer } from "./pointer.js";
import { LivePose } from "./pose.js";
import { Replay } from "./replay.js";
import { setUpServices } from "./services.js";
import { Session } from "./session.js";
import { currentTarget, jointPosition, on, update, view } from "./store.js";
import { setUpTabs } from "./tabs.js";
import { setUpTake } from "./take.js";
import { setUpTasks } from "./tasks.js";
import { setUpTimeline } from "./timeline.js";
import { setUpToolbar, setUpViewKeys } from "./toolbar.js";
import { World } from "./world.js";

const IDENTITY_POSE = 4;

async function main() {
  const world = new World(byId("view"));
  const skeleton = await call("GET", "/v1/skeleton");
  view.skeleton = skeleton;
  const shapes = bodyShapes(skeleton);
  const stage = {
    world, session: new Session(), replay: new Replay(), live: new LivePose(skeleton.joints.length),
    mannequin: new Mannequin(world.scene, skeleton, shapes), ghost: new Ghost(world.scene, skeleton, shapes),
    marker: new TargetMarker(world.scene), arrow: new PushArrow(world.scene),
    objects: new SceneObjects(world.scene), keys: new KeyFigures(world.scene, skeleton), pointer: null, moving: null,
  };
  expose(stage);
  setUpTabs();
  setUpNow();
  setUpAgenda();
  setUpTimeline();
  setUpCharts();
  setUpCommands();
  setUpTargetForm(skeleton);
  setUpToolbar(world, stage.ghost);
  setUpCharacters(stage.session);
  setUpPointer(stage);
  setUpScene(stage);
  on("frame", ({ frame, mode }) => {
    if (mode === "live") stage.live.push(frame, performance.now());
    showObjects(stage.objects, frame);
  });
  on("watching", () => stage.live.clear());
  on("mode", () => stage.live.clear());
  on("picked", () => stage.mannequin.pick(view.picked));
  draw(stage);
  await attempt(() => stage.session.restore());
  await attempt(async () => {
    const formats = await offeredFormats();
    setUpTake(formats);
    setUpEpisodes(stage.session, stage.replay, formats);
    await setUpServices(stage.session);
    await setUpTasks(stage.session);
  });
}

function setUpPointer(stage) {
  const { world, marker } = stage;
  const moveKey = setUpKeys(stage.keys);
  const act = setUpDeeds(stage.session, stage.objects);
  const push = (joint, impulse) =>
    attempt(() =>
      call("POST", `/v1/characters/${view.watching.id}/impulses`, {
        body: joint, impulse_ns: impulse.map((value) => Math.round(value * 10) / 10),
      }),
    );
  const steer = makeSteering();
  const pointer = new Pointer(stage, {
    object: (name) => act(name),
    moveKey,
    floor: (point) => {
      const joint = view.picked;
      pickLimb(null);
      attempt(() => sendTarget(joint, pointFor(joint, point)));
    },
    limb: (joint) => pickLimb(view.picked === joint ? null : joint),
    moveTarget: (point) => {
      stage.moving = { joint: marker.joint, position_m: point.toArray() };
      steer(marker.joint, point.toArray());
    },
    dropTarget: (point) => {
      steer(marker.joint, point.toArray()).then(() => {
        stage.moving = null;
      });
    },
    push: (joint, impulse) => push(joint, impulse.toArray()),
    pushing: (newtonseconds) => {
      world.canvas.classList.toggle("dragging", newtonseconds !== null);
    },
  });
  stage.pointer = pointer;
  const allow = () => {
    pointer.enabled = view.mode === "live" && view.watching?.kind === "character";
    pointer.objectsEnabled = view.mode === "live";
  };
  on("mode", allow);
  on("watching", allow);
  setUpViewKeys(world, (joint, impulse) => {
    if (pointer.enabled) push(joint, impulse);
  });
}

/** The objects are those of the character watched, or of the episode replayed, as its seed drew them. */
function setUpScene({ world, objects, replay }) {
  let shown = null;
  const refresh = () => {
    const wanted = view.mode === "replay" ? `/v1/episodes/${replay.id}/scene`
      : !view.watching?.kind ? null : `/v1/${view.watching.kind}s/${view.watching.id}/scene`;
    if (wanted === shown) return;
    shown = wanted;
    objects.use(null);
    update("scene", { scene: null });
    if (wanted === null) return;
    attempt(async () => {
      const scene = await call("GET", wanted);
      if (shown !== wanted) return;
      objects.use(scene);
      update("scene", { scene });
      world.makeRoomFor(scene.bodies.map((body) => body.position_w_m), jointPosition("pelvis") ?? undefined);
    });
  };
  on("watching", refresh);
  on("mode", refresh);
  refresh();
}

function showObjects(objects, frame) {
  const count = frame.objects?.length ?? 0;
  if (frame.objectPoses !== undefined) {
    const poses = frame.objectPoses;
    const part = (from, size) =>
      Float32Array.from({ length: count * size }, (_, k) => poses[7 * Math.floor(k / size) + from + (k % size)]);
    objects.show(frame.objects, part(0, 3), part(3, IDENTITY_POSE));
  } else {
    objects.show(frame.objects ?? [], frame.objectPositions, frame.objectRotations);
  }
}

function draw(stage) {
  const { world, mannequin, ghost, marker, live, replay } = stage;
  let last = performance.now();
  function step(now) {
    const seconds = Math.min((now - last) / 1000, 1);
    last = now;
    const pose = view.mode === "replay" ? replay.at(seconds) : live.at(now);
    if (pose !== null) {
      mannequin.show(pose);
      world.follow(pose.positions, stage.pointer.steadies(now) ? 0 : seconds);
      if (view.mode === "live" && view.frame !== null) ghost.show(view.plan, view.frame.tick, pose);
      else ghost.hide();
    }
    marker.show(stage.moving ?? currentTarget(), (now / 1600) % 1);
    world.render(now);
    requestAnimationFrame(step);
  }
  requestAnimationFrame(step);
}

/** What the page shows, for tests and the curious: read from what is drawn and not asked of the server again. */
function expose(stage) {
  window.motionloop = Object.freeze({
    get view() { return view; },
    get pelvis_m() { return jointPosition("pelvis"); },
    get tick() { return view.frame?.tick ?? null; },
    get target() { return currentTarget(); },
    get health() { return view.health; },
    get drawn_objects() { return stage.objects.shown(); },
    get drawn_pelvis_m() { return stage.mannequin.drawn("pelvis"); },
    get drawn_target_m() { return stage.marker.drawn(); },
    get held() { return stage.pointer.held(); },
    get still() { return stage.world.still; },
    drawn_key_m: (joint) => stage.keys.drawn(joint),
    drawn_m: (joint) => stage.mannequin.drawn(joint),
    joint_m: jointPosition,
    screenOf: (position) => onScreen(stage.world, position),
  });
}

main().catch((error) => {
  toast(`The page could not start: ${error.message}`);
  throw error;
});
