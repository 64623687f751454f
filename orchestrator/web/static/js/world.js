// The room: renderer, light, floor and the camera that follows.

import { OrbitControls } from "/web/vendor/OrbitControls.js";
import * as THREE from "/web/vendor/three.module.js";

THREE.Object3D.DEFAULT_UP.set(0, 0, 1); // the world's Z is up, as everywhere in motionloop

const LOOKS = {
  light: { grid: 0x8d99ad, line: 0x5f6d85, floor: 0xf7f9fc, sky: 0xffffff, ground: 0xaab4c4, key: 2.1, fill: 1.75,
    shadow: 0.26 },
  dark: { grid: 0x47536a, line: 0x6c7b96, floor: 0x242b38, sky: 0xb9c8ea, ground: 0x2a2f3a, key: 2.3, fill: 1.25,
    shadow: 0.5 },
};
const LOOK_HEIGHT_M = 0.86;
const CHEST_M = 1.2;
const FAR_THING_M = 5; // what is farther from the character need not be in view at first
const [NEAREST_ROOM, FARTHEST_ROOM] = [1.4, 2.6]; // times the usual distance
const WELL_WITHIN = 0.8; // of half the picture
const FOLLOW_RATE = 3.5; // per second
const SLOW_FRAME_MS = 40;
const STILL = 1e-5; // metres, and parts of one
const SOFTWARE = /swiftshader|llvmpipe|softpipe|software|basic render/i;

const FLOOR_VERTEX = `
  varying vec2 place;
  void main() {
    vec4 world = modelMatrix * vec4(position, 1.0);
    place = world.xy;
    gl_Position = projectionMatrix * viewMatrix * world;
  }`;
const FLOOR_FRAGMENT = `
  varying vec2 place;
  uniform vec2 middle;
  uniform vec3 grid, line, base;
  float lines(vec2 p, float width) {
    vec2 nearest = abs(fract(p - 0.5) - 0.5) / fwidth(p);
    return 1.0 - clamp(min(nearest.x, nearest.y) - width, 0.0, 1.0);
  }
  void main() {
    float away = length(place - middle);
    float fade = 1.0 - smoothstep(2.5, 11.0, away);
    float fine = lines(place * 2.0, 0.0) * 0.30 * (1.0 - smoothstep(2.0, 6.0, away));
    float metre = lines(place, 0.15) * 0.62;
    float strength = max(fine, metre);
    vec3 colour = mix(base, mix(grid, line, metre), strength);
    gl_FragColor = vec4(colour, fade * mix(0.62, 0.95, strength));
    #include <colorspace_fragment>
  }`;

/** Everything that does not move by itself. */
export class World {
  constructor(canvas) {
    this.canvas = canvas;
    // Without a graphics card every pixel costs time that the simulation on the same machine needs.
    this.frugal = !location.search.includes("draw=full") && drawsInSoftware();
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: !this.frugal, alpha: true });
    this.renderer.shadowMap.enabled = true;
    this.renderer.shadowMap.type = THREE.PCFShadowMap;
    this.renderer.toneMapping = THREE.NeutralToneMapping;
    this.renderer.toneMappingExposure = 1.0;
    this.scene = new THREE.Scene();
    this.camera = new THREE.PerspectiveCamera(34, 1, 0.05, 60);
    this.controls = new OrbitControls(this.camera, canvas);
    Object.assign(this.controls, {
      enableDamping: true, dampingFactor: 0.12, minDistance: 1.4, maxDistance: 14, maxPolarAngle: 1.54,
      screenSpacePanning: false, zoomSpeed: 0.8,
    });
    this.following = true;
    this.still = false; // whether the last two pictures were seen from the same place
    this.seenFrom = new THREE.Matrix4();
    this.roomFor = "[]";
    this.scale = this.frugal ? 0.6 : 1;
    this.cost = 16;
    this.next = 0;
    this.makeLight();
    this.makeFloor();
    this.scheme = window.matchMedia("(prefers-color-scheme: dark)");
    this.scheme.addEventListener("change", () => this.dress());
    this.dress();
    this.frameUp();
    new ResizeObserver(() => this.resize()).observe(canvas);
    this.resize();
  }

  /** Put the camera where it starts: ahead of the character and to its side, `away` times as far as usual. */
  frameUp(pelvis = [0, 0, 0], away = 1) {
    this.controls.target.set(pelvis[0], pelvis[1], LOOK_HEIGHT_M);
    this.camera.position.set(pelvis[0] + 3.3 * away, pelvis[1] - 2.9 * away, LOOK_HEIGHT_M + 0.9 * away * away);
    this.controls.update();
  }

  /** Make room for the things of a scene, or for the character alone: how much is in view, and in the light. */
  makeRoomFor(places, pelvis = [0, 0, 0]) {
    const things = places.length > 0;
    const half = things ? 4 : 1.8;
    Object.assign(this.key.shadow.camera, { left: -half, right: half, top: half, bottom: -half });
    this.key.shadow.camera.updateProjectionMatrix();
    this.shade.scale.setScalar(things ? 2.4 : 1);
    const look = JSON.stringify(places);
    if (look === this.roomFor) return;
    this.roomFor = look;
    const near = places.filter(([x, y]) => Math.hypot(x - pelvis[0], y - pelvis[1]) < FAR_THING_M);
    let away = things ? NEAREST_ROOM : 1;
    do {
      this.frameUp(pelvis, away);
      away += 0.2;
    } while (away <= FARTHEST_ROOM && near.some((place) => !this.seesAt(place)));
  }

  /** Whether something that stands at a place, as high as a chest, is well within the picture. */
  seesAt([x, y]) {
    this.camera.updateMatrixWorld();
    const seen = new THREE.Vector3(x, y, CHEST_M).project(this.camera);
    return Math.abs(seen.x) < WELL_WITHIN && Math.abs(seen.y) < WELL_WITHIN;
  }

  /**
   * Let the camera go with the pelvis for some seconds (0: it keeps still), keeping the angle the viewer has chosen; the
   * light goes along.
   */
  follow(pelvis, seconds) {
    const target = this.controls.target;
    if (this.following) {
      const part = 1 - Math.exp(-FOLLOW_RATE * seconds);
      const dx = (pelvis[0] - target.x) * part;
      const dy = (pelvis[1] - target.y) * part;
      target.x += dx;
      target.y += dy;
      this.camera.position.x += dx;
      this.camera.position.y += dy;
    }
    this.key.target.position.set(pelvis[0], pelvis[1], 0.8);
    this.key.position.set(pelvis[0] + 2.2, pelvis[1] - 1.6, 4.6);
    this.rim.target.position.copy(this.key.target.position);
    this.rim.position.set(pelvis[0] - 3, pelvis[1] + 3, 3.2);
    this.floor.position.set(target.x, target.y, 0);
    this.shade.position.set(pelvis[0], pelvis[1], 0.002);
    this.floor.material.uniforms.middle.value.set(target.x, target.y);
  }

  /** Turn or zoom by keys. */
  nudge(azimuth, polar, zoom) {
    const offset = this.camera.position.clone().sub(this.controls.target);
    const sphere = new THREE.Spherical().setFromVector3(new THREE.Vector3(offset.y, offset.z, offset.x));
    sphere.theta += azimuth;
    sphere.phi = Math.min(Math.max(sphere.phi + polar, 0.15), 1.54);
    sphere.radius = Math.min(Math.max(sphere.radius * zoom, 1.4), 14);
    const turned = new THREE.Vector3().setFromSpherical(sphere);
    this.camera.position.copy(this.controls.target).add(new THREE.Vector3(turned.z, turned.x, turned.y));
  }

  /**
   * Draw at `now` (ms) if it is time to. Where drawing is slow it happens less often, so that at least half of the
   * time is left for states, input and everything else.
   */
  render(now) {
    this.controls.update();
    if (now < this.next) return;
    const started = performance.now();
    this.renderer.render(this.scene, this.camera);
    const { elements } = this.camera.matrixWorld;
    this.still = this.seenFrom.elements.every((value, i) => Math.abs(value - elements[i]) < STILL);
    this.seenFrom.copy(this.camera.matrixWorld);
    requestAnimationFrame((then) => {
      this.cost += 0.2 * (Math.min(Math.max(then - started, performance.now() - started), 1000) - this.cost);
    });
    this.next = this.cost > SLOW_FRAME_MS ? now + 2 * this.cost : 0;
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (width === 0 || height === 0) return;
    this.renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2) * this.scale);
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    // A narrow screen sees as much of the character's sides as a wide one.
    this.camera.fov = width / height < 0.9 ? 44 : 34;
    // The command box covers the lower edge: the middle of the picture is a little above the middle of the view.
    this.camera.setViewOffset(width, height, 0, Math.round(0.045 * height), width, height);
    this.camera.updateProjectionMatrix();
  }

  makeLight() {
    this.fill = new THREE.HemisphereLight(0xffffff, 0x888888, 1.2);
    this.key = new THREE.DirectionalLight(0xfff4e6, 2.2);
    this.key.castShadow = true;
    this.key.shadow.mapSize.setScalar(this.frugal ? 512 : 1024);
    this.key.shadow.radius = 4;
    this.key.shadow.bias = -0.0006;
    this.key.shadow.normalBias = 0.02;
    Object.assign(this.key.shadow.camera, { left: -1.8, right: 1.8, top: 1.8, bottom: -1.8, near: 0.5, far: 9 });
    this.rim = new THREE.DirectionalLight(0xdfe9ff, 1.1);
    this.scene.add(this.fill, this.key, this.key.target, this.rim, this.rim.target);
  }

  makeFloor() {
    const plane = new THREE.PlaneGeometry(26, 26);
    const uniforms = {
      middle: { value: new THREE.Vector2() }, grid: { value: new THREE.Color() }, line: { value: new THREE.Color() },
      base: { value: new THREE.Color() },
    };
    this.floor = new THREE.Mesh(
      plane,
      new THREE.ShaderMaterial({
        uniforms, vertexShader: FLOOR_VERTEX, fragmentShader: FLOOR_FRAGMENT, transparent: true, depthWrite: false,
      }),
    );
    this.floor.renderOrder = -2;
    this.shade = new THREE.Mesh(new THREE.PlaneGeometry(5, 5), new THREE.ShadowMaterial({ opacity: 0.3 }));
    this.shade.receiveShadow = true;
    this.shade.renderOrder = -1;
    this.scene.add(this.floor, this.shade);
  }

  dress() {
    const look = LOOKS[this.scheme.matches ? "dark" : "light"];
    const { grid, line, base } = this.floor.material.uniforms;
    grid.value.set(look.grid);
    line.value.set(look.line);
    base.value.set(look.floor);
    this.fill.color.set(look.sky);
    this.fill.groundColor.set(look.ground);
    this.fill.intensity = look.fill;
    this.key.intensity = look.key;
    this.shade.material.opacity = look.shadow;
  }
}

/** The accent colour of the style sheets. */
export function accent() {
  return new THREE.Color(getComputedStyle(document.documentElement).getPropertyValue("--accent").trim());
}

function drawsInSoftware() {
  const gl = document.createElement("canvas").getContext("webgl2");
  const names = gl?.getExtension("WEBGL_debug_renderer_info");
  return names ? SOFTWARE.test(gl.getParameter(names.UNMASKED_RENDERER_WEBGL)) : false;
}
