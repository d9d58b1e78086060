// Three-dimensional view of bodies, drawn by three.js when something has changed. Python's side is stage.py.
import { OrbitControls, THREE } from "nicegui-scene";

const CLICK_PX = 5; // a pointer that moves less between down and up has clicked; otherwise it has turned the view
const TIP_COLOUR = 0x1769aa;

THREE.ColorManagement.enabled = false; // colours arrive as the screen shows them

function bytes(text) {
  return Uint8Array.from(atob(text), (character) => character.charCodeAt(0));
}

export default {
  template: '<div style="position:relative;overflow:hidden;touch-action:none"><canvas style="display:block"></canvas></div>',

  mounted() {
    this.bodies = new Map();
    this.scene = new THREE.Scene();
    this.scene.background = new THREE.Color("#f6f7f9");
    this.camera = new THREE.PerspectiveCamera(30, 1, 0.1, 1000);
    this.sky = new THREE.HemisphereLight(0xffffff, 0x8a8f98, 1.6);
    this.scene.add(this.sky, this.camera);
    const lamp = new THREE.DirectionalLight(0xffffff, 1.6);
    lamp.position.set(0.4, 0.8, 1.0);
    this.camera.add(lamp);
    this.arrow = new THREE.ArrowHelper(new THREE.Vector3(0, 1, 0), new THREE.Vector3(), 1, TIP_COLOUR, 0.7, 0.4);
    this.arrow.visible = false;
    this.scene.add(this.arrow);
    this.canvas = this.$el.querySelector("canvas");
    this.renderer = new THREE.WebGLRenderer({ canvas: this.canvas, antialias: true });
    this.renderer.outputColorSpace = THREE.LinearSRGBColorSpace;
    this.renderer.setPixelRatio(window.devicePixelRatio);
    this.controls = new OrbitControls(this.camera, this.canvas);
    this.controls.addEventListener("change", () => this.draw());
    this.canvas.addEventListener("pointerdown", (event) => (this.down = [event.clientX, event.clientY]));
    this.canvas.addEventListener("pointerup", (event) => this.click(event));
    this.resized = new ResizeObserver(() => this.resize());
    this.resized.observe(this.$el);
    this.$el.stage = this; // for tests
    this.resize();
    this.$emit("ready");
  },

  unmounted() {
    this.resized.disconnect();
    this.controls.dispose();
    this.renderer.dispose();
  },

  methods: {
    put(name, points, triangles, colours, colour, opacity) {
      this.remove(name);
      const geometry = new THREE.BufferGeometry();
      geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array(bytes(points).buffer), 3));
      geometry.setIndex(new THREE.BufferAttribute(new Uint32Array(bytes(triangles).buffer), 1));
      const solid = opacity === 1;
      const material = new THREE.MeshLambertMaterial({
        color: colours ? "#ffffff" : colour, vertexColors: Boolean(colours), side: THREE.DoubleSide,
        opacity, transparent: !solid, depthWrite: solid,
      });
      const body = new THREE.Mesh(geometry, material);
      body.name = name;
      body.renderOrder = solid ? 0 : 1;
      this.bodies.set(name, body);
      this.scene.add(body);
      this.colour(geometry, colours);
      geometry.computeVertexNormals();
      this.draw();
    },

    move(name, points, colours) {
      const geometry = this.bodies.get(name)?.geometry;
      if (!geometry) return;
      geometry.attributes.position.array.set(new Float32Array(bytes(points).buffer));
      geometry.attributes.position.needsUpdate = true;
      this.colour(geometry, colours);
      geometry.computeVertexNormals();
      geometry.boundingSphere = null;
      this.draw();
    },

    colour(geometry, colours) {
      if (colours) geometry.setAttribute("color", new THREE.BufferAttribute(bytes(colours), 3, true));
    },

    pose(name, matrix) {
      const body = this.bodies.get(name);
      if (!body) return;
      body.matrixAutoUpdate = false;
      body.matrix.set(...matrix);
      body.matrixWorldNeedsUpdate = true;
      this.draw();
    },

    show(name, visible) {
      const body = this.bodies.get(name);
      if (body) body.visible = visible;
      this.draw();
    },

    remove(name) {
      const body = this.bodies.get(name);
      if (!body) return;
      this.scene.remove(body);
      body.geometry.dispose();
      body.material.dispose();
      this.bodies.delete(name);
      this.draw();
    },

    look(towards, up, centre, radius) {
      this.home = { towards: new THREE.Vector3(...towards), up: new THREE.Vector3(...up),
                    centre: new THREE.Vector3(...centre), radius };
      this.goHome();
    },

    goHome() {
      if (!this.home) return;
      const { towards, up, centre, radius } = this.home;
      const half = (0.5 * this.camera.fov * Math.PI) / 180;
      const narrow = Math.min(1, this.camera.aspect); // so that the body fits into a tall view, too
      this.camera.up.copy(up);
      this.sky.position.copy(up);
      this.camera.position.copy(centre).addScaledVector(towards, radius / Math.sin(half) / narrow);
      this.camera.near = radius / 20;
      this.camera.far = radius * 40;
      this.controls.target.copy(centre);
      this.controls.update();
      this.draw();
    },

    point(tip, along, length) {
      this.arrow.visible = Boolean(tip);
      if (tip) {
        const direction = new THREE.Vector3(...along);
        this.arrow.position.set(...tip).addScaledVector(direction, -length);
        this.arrow.setDirection(direction);
        this.arrow.setLength(length, 0.25 * length, 0.15 * length);
      }
      this.draw();
    },

    click(event) {
      const [x, y] = this.down ?? [Infinity, Infinity];
      this.down = null;
      if (Math.hypot(event.clientX - x, event.clientY - y) > CLICK_PX) return;
      const box = this.canvas.getBoundingClientRect();
      const place = new THREE.Vector2((2 * (event.clientX - box.left)) / box.width - 1,
                                      1 - (2 * (event.clientY - box.top)) / box.height);
      const ray = new THREE.Raycaster();
      ray.setFromCamera(place, this.camera);
      const solid = [...this.bodies.values()].filter((body) => !body.material.transparent);
      const [hit] = ray.intersectObjects(solid, false);
      if (hit) this.$emit("place", { body: hit.object.name, point: hit.point.toArray() });
    },

    resize() {
      const { clientWidth: width, clientHeight: height } = this.$el;
      if (!width || !height) return;
      const wasTall = this.camera.aspect < 1;
      this.renderer.setSize(width, height);
      this.camera.aspect = width / height;
      this.camera.updateProjectionMatrix();
      if (wasTall || this.camera.aspect < 1) this.goHome();
      this.draw();
    },

    draw() {
      if (this.waiting) return;
      this.waiting = true;
      requestAnimationFrame(() => {
        this.waiting = false;
        this.renderer.render(this.scene, this.camera);
      });
    },
  },
};
