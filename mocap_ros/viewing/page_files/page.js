// Copyright 2026 mocap_ros developers
// SPDX-License-Identifier: Apache-2.0

// The page that `mocap-ros view IN -o page.html` writes. `mocap_ros/viewing/page.py` fills in the scene (JSON) and
// the data (arrays); THREE is the bundle of three.js beside this file. Coordinates are those of the camera's optical
// frame (x right, y down, z forward, m); the group `world` turns them so that up is up and the floor is level.
'use strict';

(() => {
  const NOT_A_NUMBER = -32768; // the int16 that stands for a missing value
  const TRAIL_S = 2; // s; length of the trails
  const JOINT_RADIUS_M = 0.028; // m; joints stand out from bones and hide nothing
  const BONE_RADIUS_M = 0.016; // m
  const [DISC_RADIUS_M, DISC_HEIGHT_M, DISC_DROP_M] = [0.14, 0.01, 0.03]; // under a foot that stands
  const BODY_RADIUS_M = 0.9; // m; of the sphere that holds a person, for the distance of the view
  const MAX_RATIO = 2; // canvas pixels per CSS pixel; more is not seen and takes time
  const MIN_RATIO = 0.5; // canvas pixels per CSS pixel; less is too coarse to read
  const GAP_S = 0.2; // s; a person who is missing for less stays where they were, and for longer interrupts the curves
  const FOLLOW_S = 0.15; // s; time constant with which the view follows people who move
  const JUMP_S = 0.5; // s; after a larger step in time the view is at once where the people are
  const SETTLED_M = 1e-3; // m; a view that is nearer to the people than this stands still
  const IMAGE_S = 1; // s; without an image for longer, none is shown
  const READ_AHEAD = 4; // images that are decoded before they are shown
  const KEPT_IMAGES = 24; // decoded images; more would only take memory
  const LIVE_FRAMES = 900; // of a live scene that are kept at least, 30 s at 30 Hz; at most twice as many
  const LIVE_PEOPLE = 60; // people in one image of a live scene at most
  const LIVE_TRAIL = 120; // frames of a trail of a live scene at most
  const PACE_FRAMES = 30; // of a live scene, whose rate and delay are shown
  const MAX_DELAY_MS = 5000; // ms; larger ones are those of another clock
  const CURVES_S = 1; // s between two drawings of the curves of a live scene
  const RETRY_MS = 1000; // ms after which a page asks again for frames
  const SILENCE_S = 10; // s without skeletons after which a live scene is grey
  const NAME_STEPS = 8; // heights of a line by which a name moves up at most, out of the way of others
  const SLOW_FRAME_MS = 30; // ms; slower pictures lower the resolution, so that 30 pictures a second remain
  const VERY_SLOW_FRAME_MS = 100; // ms; pictures that are slower than this lower it sooner
  const MOTION_NAMES = ['unknown', 'periodic', 'not periodic'];
  const MOTION_COLOURS = ['#dddddd', '#8fbf8f', '#b9a3d0'];
  const $ = (id) => document.getElementById(id);

  function fail(text) {
    $('fault').textContent = text;
    $('fault').hidden = false;
  }

  // ---- data -------------------------------------------------------------------------------------------------------

  async function inflate(text) {
    const packed = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream('gzip'));
    return new Uint8Array(await new Response(stream).arrayBuffer());
  }

  // Arrays are stored column by column as differences from row to row, and their bytes plane by plane.
  function unpack(bytes, { offset, rows, columns, size }) {
    const count = rows * columns;
    const out = size === 1 ? new Uint8Array(count) : size === 2 ? new Int16Array(count) : new Int32Array(count);
    for (let column = 0; column < columns; column++) {
      let value = 0;
      for (let row = 0; row < rows; row++) {
        let step = 0;
        for (let plane = 0; plane < size; plane++) {
          step |= bytes[offset + plane * count + column * rows + row] << (8 * plane);
        }
        value = (value + step) | 0;
        out[row * columns + column] = value;
      }
    }
    return out;
  }

  function unpackAll(bytes, described) {
    const out = {};
    for (const [name, layout] of Object.entries(described)) out[name] = unpack(bytes, layout);
    return out;
  }

  function readScene(bytes) {
    const scene = JSON.parse($('scene').textContent);
    const ticks = unpack(bytes, scene.times);
    scene.seconds = Float64Array.from(ticks, (tick) => tick * scene.tickS);
    scene.frameCount = ticks.length;
    for (const person of scene.people) {
      Object.assign(person, unpackAll(bytes, person.arrays));
      person.rowOfFrame = findRows(scene.seconds, person.frames);
    }
    for (const input of scene.keypoints) Object.assign(input, unpackAll(bytes, input.arrays));
    if (scene.truth) Object.assign(scene.truth, unpackAll(bytes, scene.truth.arrays));
    return scene;
  }

  // A scene whose frames come from the server, as arrays of the same form that grow, and lose their oldest half.
  class LiveScene {
    constructor(scene) {
      Object.assign(this, scene, { isLive: true, palette: scene.people, count: 0, isConnected: true, newestMs: null });
      this.clear();
    }

    clear() {
      Object.assign(this, { people: [], seconds: [], frameCount: 0, keypoints: [], startMs: null, images: new Images() });
    }

    find(id) {
      let person = this.people.find((other) => other.id === id);
      if (!person) {
        const { colour, jointColours, boneColours, arrays } = this.palette[this.count++ % this.palette.length];
        person = { id, colour, jointColours, boneColours, rowOfFrame: new Array(this.frameCount - 1).fill(-1) };
        for (const name of Object.keys(arrays)) person[name] = [];
        this.people.push(person);
      }
      return person;
    }

    // Add a frame of the server; return how many of the oldest were removed.
    add({ stampMs, ids, people, keypoints, camera, toLevel, floorY, jpeg, bitmap }) {
      if (stampMs <= this.startMs + 1000 * this.seconds[this.frameCount - 1]) this.clear(); // the clock was put back
      this.startMs ??= stampMs;
      const frame = this.frameCount++;
      if (bitmap) this.images.put(frame, jpeg, bitmap);
      this.seconds.push((stampMs - this.startMs) / 1000);
      Object.assign(this, { camera, toLevel, floorY });
      ids.forEach((id, i) => {
        const person = this.find(id);
        person.rowOfFrame.push(person.frames.length);
        person.frames.push(frame);
        for (const name of Object.keys(people)) if (name !== 'frames') person[name].push(...people[name][i]);
      });
      for (const person of this.people) if (person.rowOfFrame.length <= frame) person.rowOfFrame.push(-1);
      for (const { names, bones, points } of keypoints) {
        let input = this.keypoints.find((other) => other.names.join() === names.join());
        if (!input) this.keypoints.push(input = { names, bones, frames: [], points: [] });
        input.frames.push(frame);
        input.points.push(...points);
      }
      return this.frameCount > 2 * LIVE_FRAMES ? this.forget(LIVE_FRAMES) : 0;
    }

    forget(count) {
      this.seconds.splice(0, count);
      this.frameCount -= count;
      this.images.forget(count);
      const shorten = (rows, arrays) => {
        const gone = findLast(rows.frames, count - 1) + 1;
        const total = rows.frames.length;
        for (const name of arrays) rows[name].splice(0, rows[name].length / total * gone);
        rows.frames = rows.frames.map((frame) => frame - count);
        return gone;
      };
      for (const person of this.people) {
        const gone = shorten(person, Object.keys(this.palette[0].arrays));
        person.rowOfFrame = person.rowOfFrame.slice(count).map((row) => Math.max(row - gone, -1));
      }
      for (const input of this.keypoints) shorten(input, ['points', 'frames']);
      this.people = this.people.filter((person) => person.frames.length);
      return count;
    }

    // Why nothing moves, in words; empty while skeletons come.
    explainSilence() {
      if (!this.isConnected) return 'not connected';
      if (this.newestMs === null) return `waiting for ${this.liveTopic}`;
      const silentS = Math.floor((performance.now() - this.newestMs) / 1000);
      return silentS < SILENCE_S ? '' : `no skeletons for ${silentS} s`;
    }

    // The image of a frame, as JPEG and decoded; none if it cannot be had.
    async receiveImage(number) {
      const answer = await fetch(`image?of=${number}`);
      const jpeg = await answer.blob();
      return { jpeg, bitmap: answer.ok ? await createImageBitmap(jpeg).catch(() => null) : null };
    }

    // Ask the server for frames, for ever; it answers with the newest one that is not the last.
    async receive(onFrame) {
      for (let after = 0; ;) {
        try {
          const answer = await fetch(`frame?after=${after}`);
          this.isConnected = answer.ok;
          if (!answer.ok) throw new Error(answer.status);
          const age = answer.headers.get('Age'); // s since the newest skeletons; none before the first
          if (age !== null) this.newestMs = performance.now() - 1000 * age;
          if (answer.status === 204) continue;
          const frame = await answer.json();
          if (frame.skeleton.join() !== this.joints.join()) return location.reload();
          after = frame.number;
          if (frame.hasImage) Object.assign(frame, await this.receiveImage(after));
          onFrame(frame);
        } catch (error) {
          this.isConnected = false;
          await new Promise((resolve) => setTimeout(resolve, RETRY_MS));
        }
      }
    }
  }

  // The row of a person in each frame, -1 where there is none. In frames that the tracker skipped it is the one before.
  function findRows(seconds, frames) {
    const rows = new Int32Array(seconds.length).fill(-1);
    frames.forEach((frame, row) => {
      const next = row + 1 < frames.length ? frames[row + 1] : frame;
      rows.fill(row, frame, seconds[next] - seconds[frame] < GAP_S ? Math.max(next, frame + 1) : frame + 1);
    });
    return rows;
  }

  // The index of the last value that is not above `value`, in increasing values.
  function findLast(values, value) {
    let low = 0;
    let high = values.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (values[middle] <= value) low = middle + 1; else high = middle;
    }
    return low - 1;
  }

  // Whether the processor draws in place of a graphics card, which makes smooth edges slow.
  function isDrawnInSoftware() {
    const context = document.createElement('canvas').getContext('webgl2');
    const names = context?.getExtension('WEBGL_debug_renderer_info');
    return /swiftshader|llvmpipe|software/i.test(names ? context.getParameter(names.UNMASKED_RENDERER_WEBGL) : '');
  }

  // ---- 3D ---------------------------------------------------------------------------------------------------------

  class SpaceView {
    constructor(scene, onChange) {
      this.scene = scene;
      this.canvas = $('space-view');
      this.ratio = this.movingRatio = Math.min(window.devicePixelRatio, MAX_RATIO);
      const antialias = !isDrawnInSoftware();
      this.renderer = new THREE.WebGLRenderer({ canvas: this.canvas, antialias, preserveDrawingBuffer: true });
      this.renderer.setClearColor('#fbfbfb');
      this.camera = new THREE.PerspectiveCamera(40, 1, 0.05, 500);
      this.controls = new THREE.OrbitControls(this.camera, this.canvas);
      this.controls.addEventListener('change', onChange);
      this.controls.addEventListener('start', () => { this.view = null; }); // of the user's own
      this.space = new THREE.Scene();
      this.space.add(new THREE.HemisphereLight('#ffffff', '#9a9a9a', 2.6));
      const sun = new THREE.DirectionalLight('#ffffff', 1.4);
      sun.position.set(2, 5, 3);
      this.space.add(sun);
      this.world = new THREE.Group();
      this.grid = new THREE.GridHelper(20, 20, '#bbbbbb', '#e2e2e2');
      this.frustum = new THREE.BufferGeometry();
      this.space.add(this.world, this.grid);
      this.world.add(new THREE.LineSegments(this.frustum, new THREE.LineBasicMaterial({ color: '#666666' })));
      this.placeFloorAndCamera();
      this.addPeople();
      this.labels = [];
      this.mean = new THREE.Vector3();
      this.hasMean = false;
    }

    placeFloorAndCamera() {
      const { floorY, camera, centre, toLevel, isLive } = this.scene;
      const turn = new THREE.Matrix4().set(...toLevel[0], 0, ...toLevel[1], 0, ...toLevel[2], 0, 0, 0, 0, 1);
      const flip = new THREE.Matrix4().makeRotationX(Math.PI); // y down, z forward: to y up, z backward
      this.world.quaternion.setFromRotationMatrix(flip.multiply(turn));
      this.world.updateMatrixWorld();
      const middle = isLive && this.hasMean ? this.mean.clone() : new THREE.Vector3(...centre);
      this.grid.position.copy(this.toSpace(middle)).round().setY(-floorY);
      const corners = camera.corners.flatMap((corner, i) => {
        const next = camera.corners[(i + 1) % 4];
        return [[0, 0, 0], corner, corner, next];
      });
      this.frustum.setAttribute('position', new THREE.BufferAttribute(new Float32Array(corners.flat()), 3));
    }

    addPeople() {
      const { people, bones, joints, truth, seconds } = this.scene;
      const count = this.scene.isLive ? LIVE_PEOPLE : Math.max(people.length, 1);
      const lit = () => new THREE.MeshLambertMaterial();
      const make = (geometry, material, n) => {
        const mesh = new THREE.InstancedMesh(geometry, material, n);
        mesh.frustumCulled = false;
        mesh.count = 0;
        mesh.setColorAt(0, new THREE.Color());
        this.world.add(mesh);
        return mesh;
      };
      this.joints = make(new THREE.IcosahedronGeometry(1, 1), lit(), count * joints.length);
      this.bones = make(new THREE.CylinderGeometry(1, 1, 1, 6, 1, true), lit(), count * bones.length);
      const cloud = new THREE.MeshBasicMaterial({ transparent: true, opacity: 0.13, depthWrite: false });
      this.clouds = make(new THREE.IcosahedronGeometry(1, 1), cloud, count * joints.length);
      this.discs = make(new THREE.CylinderGeometry(1, 1, 1, 24), lit(), 2 * count); // under feet that stand
      const grey = new THREE.MeshLambertMaterial();
      this.truth = truth ? make(new THREE.CylinderGeometry(1, 1, 1, 5, 1, true), grey, bones.length) : null;
      const trails = new THREE.BufferGeometry();
      const longest = this.scene.isLive ? LIVE_TRAIL : seconds.reduce(
        (most, second, frame) => Math.max(most, frame - Math.max(findLast(seconds, second - TRAIL_S), 0)), 0);
      this.trailSize = 2 * count * Math.max(longest, 1); // points of all trails together; two for each step of a person
      trails.setAttribute('position', new THREE.BufferAttribute(new Float32Array(this.trailSize * 3), 3));
      trails.setAttribute('color', new THREE.BufferAttribute(new Float32Array(this.trailSize * 3), 3));
      this.trails = new THREE.LineSegments(trails, new THREE.LineBasicMaterial({ vertexColors: true }));
      this.trails.frustumCulled = false;
      this.world.add(this.trails);
      this.matrix = new THREE.Matrix4();
      this.turn = new THREE.Quaternion();
      this.size = new THREE.Vector3();
      this.points = [0, 1, 2].map(() => new THREE.Vector3());
      this.colour = new THREE.Color();
    }

    // A point of the camera's optical frame in the frame of three.js.
    toSpace(point) { return point.applyQuaternion(this.world.quaternion); }

    isKnown(person, row, joint) { return person.joints[(row * this.scene.joints.length + joint) * 3] !== NOT_A_NUMBER; }

    jointOf(person, row, joint, out) {
      const at = (row * this.scene.joints.length + joint) * 3;
      const metre = this.scene.metrePerStep;
      return out.set(person.joints[at] * metre, person.joints[at + 1] * metre, person.joints[at + 2] * metre);
    }

    place(mesh, position, radius, colour) {
      this.matrix.compose(position, this.turn.identity(), this.size.set(radius, radius, radius));
      mesh.setMatrixAt(mesh.count, this.matrix);
      mesh.setColorAt(mesh.count++, this.colour.set(colour));
    }

    placeBone(mesh, from, to, radius, colour) {
      const [, , axis] = this.points;
      axis.subVectors(to, from);
      const length = axis.length();
      this.turn.setFromUnitVectors(this.world.up, axis.multiplyScalar(1 / Math.max(length, 1e-6)));
      const middle = axis.addVectors(from, to).multiplyScalar(0.5);
      this.matrix.compose(middle, this.turn, this.size.set(radius, length, radius));
      mesh.setMatrixAt(mesh.count, this.matrix);
      mesh.setColorAt(mesh.count++, this.colour.set(colour));
    }

    // A level disc under the points of a foot.
    placeDisc(person, row, points) {
      const middle = points.reduce((sum, joint) => sum.add(this.jointOf(person, row, joint, new THREE.Vector3())),
        new THREE.Vector3()).multiplyScalar(1 / points.length);
      this.turn.copy(this.world.quaternion).invert();
      middle.add(new THREE.Vector3(0, -DISC_DROP_M, 0).applyQuaternion(this.turn));
      this.matrix.compose(middle, this.turn, this.size.set(DISC_RADIUS_M, DISC_HEIGHT_M, DISC_RADIUS_M));
      this.discs.setMatrixAt(this.discs.count, this.matrix);
      this.discs.setColorAt(this.discs.count++, this.colour.set(this.scene.standingColour));
    }

    update(frame) {
      const { people, bones, joints, feet, truth, seconds } = this.scene;
      const [from, to] = this.points;
      const meshes = [this.joints, this.bones, this.clouds, this.discs, ...(this.truth ? [this.truth] : [])];
      for (const mesh of meshes) mesh.count = 0;
      let trailPoints = 0;
      const mean = new THREE.Vector3();
      const middles = [];
      let present = 0;
      const trailStart = Math.max(findLast(seconds, seconds[frame] - TRAIL_S), 0);
      for (const person of people) {
        const row = person.rowOfFrame[frame];
        if (row < 0) continue;
        const state = person.state[row];
        const isPale = state & 3; // predicted or tentative
        feet.forEach((points, side) => {
          if (state >> 6 + side & 1 && points.every((joint) => this.isKnown(person, row, joint))) {
            this.placeDisc(person, row, points);
          }
        });
        bones.forEach(([a, b], bone) => {
          if (!this.isKnown(person, row, a) || !this.isKnown(person, row, b)) return;
          this.jointOf(person, row, a, from);
          this.jointOf(person, row, b, to);
          const colour = isPale ? this.scene.paleColour : person.boneColours[bone];
          this.placeBone(this.bones, from, to, BONE_RADIUS_M, colour);
        });
        for (let joint = 0; joint < joints.length; joint++) {
          if (!this.isKnown(person, row, joint)) continue;
          this.jointOf(person, row, joint, from);
          const inferred = person.inferred[row] >> joint & 1;
          const colour = inferred ? this.scene.inferredColour : isPale ? this.scene.paleColour : person.jointColours[joint];
          this.place(this.joints, from, JOINT_RADIUS_M, colour);
          const std = person.std[row * joints.length + joint];
          if (std !== 255 && $('clouds').checked) this.place(this.clouds, from, std * this.scene.stdPerStep, colour);
          mean.add(from);
          present++;
        }
        if (this.isKnown(person, row, this.scene.trailJoint)) {
          middles.push(this.jointOf(person, row, this.scene.trailJoint, new THREE.Vector3()));
        }
        trailPoints = this.addTrail(person, trailStart, frame, trailPoints);
      }
      if (this.truth) {
        bones.forEach(([a, b]) => {
          const read = (joint, out) => {
            const at = (frame * joints.length + joint) * 3;
            const metre = this.scene.metrePerStep;
            return out.fromArray(truth.joints, at).multiplyScalar(metre);
          };
          if ([a, b].some((joint) => truth.joints[(frame * joints.length + joint) * 3] === NOT_A_NUMBER)) return;
          this.placeBone(this.truth, read(a, from), read(b, to), BONE_RADIUS_M / 2, this.scene.truthColour);
        });
      }
      for (const mesh of meshes) {
        mesh.instanceMatrix.needsUpdate = true;
        if (mesh.instanceColor) mesh.instanceColor.needsUpdate = true;
      }
      this.trails.geometry.setDrawRange(0, trailPoints);
      for (const name of ['position', 'color']) this.trails.geometry.attributes[name].needsUpdate = true;
      if (present) {
        this.mean.copy(mean.multiplyScalar(1 / present));
        this.hasMean = true;
        this.radius = Math.max(...middles.map((middle) => middle.distanceTo(this.mean)), 0) + BODY_RADIUS_M;
      }
    }

    addTrail(person, firstFrame, lastFrame, count) {
      const position = this.trails.geometry.attributes.position;
      const colour = this.trails.geometry.attributes.color;
      this.colour.set(person.colour);
      let before = -1;
      for (let frame = firstFrame; frame <= lastFrame && count + 2 <= this.trailSize; frame++) {
        let row = person.rowOfFrame[frame];
        if (row >= 0 && !this.isKnown(person, row, this.scene.trailJoint)) row = -1;
        if (row >= 0 && before >= 0) {
          for (const r of [before, row]) {
            this.jointOf(person, r, this.scene.trailJoint, this.points[0]);
            position.setXYZ(count, this.points[0].x, this.points[0].y, this.points[0].z);
            colour.setXYZ(count++, this.colour.r, this.colour.g, this.colour.b);
          }
        }
        before = row;
      }
      return count;
    }

    // Where the people are, in the frame of three.js.
    target() {
      const at = this.hasMean && $('follow').checked ? this.mean.toArray() : this.scene.centre;
      return this.toSpace(new THREE.Vector3(...at));
    }

    // Move the view towards the people, wholly where `elapsed` (s) is infinite; return whether it has arrived.
    follow(elapsed) {
      if (!$('follow').checked || !this.hasMean || this.isAtCamera) return true;
      const shift = this.target().sub(this.controls.target);
      const distance = shift.length();
      const share = distance < SETTLED_M ? 1 : 1 - Math.exp(-elapsed / FOLLOW_S);
      shift.multiplyScalar(share);
      this.controls.target.add(shift);
      this.camera.position.add(shift);
      return distance * (1 - share) < SETTLED_M;
    }

    choose(view) {
      this.view = view;
      const target = this.target();
      const radius = $('follow').checked && this.hasMean ? this.radius : this.scene.extent / 2;
      const distance = 2.2 * radius + 2.2;
      this.isAtCamera = view === 'camera';
      const direction = { free: [-0.75, 0.45, 0.75], side: [-1, 0.02, 0], top: [0, 1, 0.001] }[view];
      this.camera.fov = 40;
      if (this.isAtCamera) {
        this.camera.position.set(0, 0, 0);
        this.camera.fov = this.scene.camera.fovDeg;
        this.toSpace(this.controls.target.set(0, 0, this.scene.centre[2]));
      } else {
        this.controls.target.copy(target);
        this.camera.position.fromArray(direction).normalize().multiplyScalar(distance).add(target);
      }
      this.camera.updateProjectionMatrix();
      this.controls.update();
    }

    resize() {
      const { clientWidth, clientHeight } = this.canvas;
      this.renderer.setPixelRatio(this.ratio);
      this.renderer.setSize(clientWidth, clientHeight, false);
      this.camera.aspect = clientWidth / Math.max(clientHeight, 1);
      this.camera.updateProjectionMatrix();
    }

    lowerResolution() {
      if (this.movingRatio === MIN_RATIO) return;
      this.movingRatio = Math.max(this.movingRatio * 0.8, MIN_RATIO);
      this.setMoving(true);
    }

    // Choose the resolution of moving pictures, or the full one of those that stand.
    setMoving(isMoving) {
      const ratio = isMoving ? this.movingRatio : Math.min(window.devicePixelRatio, MAX_RATIO);
      if (ratio === this.ratio) return;
      this.ratio = ratio;
      this.resize();
    }

    draw(frame) {
      this.renderer.render(this.space, this.camera);
      this.drawNames(frame);
    }

    drawNames(frame) {
      const { people, joints } = this.scene;
      const wanted = [];
      const want = (text, person, row, joint, above, kind) => {
        if (!this.isKnown(person, row, joint)) return;
        const at = this.toSpace(this.jointOf(person, row, joint, this.points[0]));
        at.setY(at.y + above).project(this.camera);
        const [x, y] = [(at.x + 1) / 2 * this.canvas.clientWidth, (1 - at.y) / 2 * this.canvas.clientHeight];
        if (at.z <= 1) wanted.push({ text, kind, x, y, depth: at.z, colour: kind ? '' : person.colour });
      };
      for (const person of people) {
        const row = person.rowOfFrame[frame];
        if (row < 0) continue;
        if (people.length > 1) want(person.id, person, row, 0, 0.22, '');
        if ($('joint-names').checked) joints.forEach((name, joint) => want(name, person, row, joint, 0, 'joint'));
      }
      // The nearest keep their places; the others go up to where they are free, and joint names go.
      wanted.sort((a, b) => Boolean(a.kind) - Boolean(b.kind) || a.depth - b.depth);
      const placed = [];
      for (const label of wanted) {
        const height = label.kind ? 11 : 15;
        const width = label.text.length * (label.kind ? 6 : 7.5);
        const left = label.kind ? label.x : label.x - width / 2;
        const isTaken = (y) => placed.some((other) => left < other.left + other.width && other.left < left + width
          && y < other.y + other.height && other.y < y + height);
        let steps = 0;
        while (steps <= NAME_STEPS && isTaken(label.y - steps * height)) steps++;
        label.isFree = steps <= (label.kind ? 0 : NAME_STEPS);
        label.y -= steps * height;
        if (label.isFree) placed.push({ left, width, height, y: label.y });
      }
      const box = $('names');
      while (this.labels.length < wanted.length) this.labels.push(box.appendChild(document.createElement('span')));
      this.labels.forEach((label, i) => {
        label.hidden = !wanted[i]?.isFree;
        if (label.hidden) return;
        const { text, kind, x, y, colour } = wanted[i];
        label.textContent = text;
        label.className = kind;
        label.style.color = colour;
        label.style.left = `${x}px`;
        label.style.top = `${y}px`;
      });
    }
  }

  // ---- 2D ---------------------------------------------------------------------------------------------------------

  function fitCanvas(canvas) {
    const ratio = Math.min(window.devicePixelRatio, MAX_RATIO);
    canvas.width = Math.max(canvas.clientWidth * ratio, 1);
    canvas.height = Math.max(canvas.clientHeight * ratio, 1);
    const context = canvas.getContext('2d');
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    return context;
  }

  // The images behind the points, as JPEG, decoded when they are needed.
  class Images {
    constructor(frames = [], jpegs = []) {
      Object.assign(this, { frames, jpegs, onChange: () => {} });
      this.decoded = new Map(); // by JPEG, the oldest first; null while it is being decoded
    }

    static unpack({ frames, sizes }, text) {
      const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
      let at = 0;
      return new Images(frames, sizes.map((size) => new Blob([bytes.subarray(at, at += size)], { type: 'image/jpeg' })));
    }

    put(frame, jpeg, bitmap) {
      this.frames.push(frame);
      this.jpegs.push(jpeg);
      this.keep(jpeg, bitmap);
    }

    forget(count) {
      this.jpegs.splice(0, findLast(this.frames, count - 1) + 1);
      this.frames = this.frames.map((frame) => frame - count).filter((frame) => frame >= 0);
    }

    keep(jpeg, bitmap) {
      this.decoded.set(jpeg, bitmap);
      if (this.decoded.size > KEPT_IMAGES) {
        const [oldest, old] = this.decoded.entries().next().value;
        this.decoded.delete(oldest);
        old?.close();
      }
    }

    load(jpeg) {
      if (!jpeg || this.decoded.has(jpeg)) return;
      this.keep(jpeg, null);
      createImageBitmap(jpeg).then((bitmap) => {
        if (this.decoded.has(jpeg)) this.decoded.set(jpeg, bitmap);
        this.onChange();
      }, () => {});
    }

    // The newest image at a frame: its own frame and, when it has been decoded, its bitmap.
    find(frame) {
      const index = findLast(this.frames, frame);
      for (let i = index; i <= index + READ_AHEAD; i++) this.load(this.jpegs[i]);
      return index < 0 ? null : { frame: this.frames[index], bitmap: this.decoded.get(this.jpegs[index]) };
    }
  }

  class ImageView {
    constructor(scene, onChange) {
      this.scene = scene;
      if (scene.images && !scene.isLive) scene.images = Images.unpack(scene.images, $('images').textContent.trim());
      this.onChange = onChange;
      this.shown = -1; // the frame that is drawn
      this.canvas = $('image-view');
      this.explain();
    }

    explain() {
      const { scene } = this;
      $('image-caption').textContent = scene.keypoints.length
        ? '2D input (black) and the 3D result in the image (colours)' : 'the 3D result in the image; the input is not known';
      if (scene.camera.isNominal) {
        $('image-caption').textContent += '; nominal focal length: all distances are proportional to it';
      }
    }

    resize() { this.context = fitCanvas(this.canvas); }

    update(frame) {
      const { context, scene } = this;
      if (scene.images) scene.images.onChange = this.onChange;
      const image = scene.images?.find(frame);
      const hasImage = image && scene.seconds[frame] - scene.seconds[image.frame] < IMAGE_S;
      if (hasImage && !image.bitmap) return; // what is shown stays until the image is there: they are in step
      if (hasImage) frame = image.frame;
      this.shown = frame;
      const { clientWidth: width, clientHeight: height } = this.canvas;
      const [imageWidth, imageHeight] = scene.camera.imageSize;
      const scale = Math.min(width / imageWidth, height / imageHeight);
      const dot = Math.min(Math.max(4 * scale, 2), 3); // px
      context.clearRect(0, 0, width, height);
      const x0 = (width - imageWidth * scale) / 2;
      const y0 = (height - imageHeight * scale) / 2;
      context.fillStyle = '#ffffff';
      context.fillRect(x0, y0, imageWidth * scale, imageHeight * scale);
      if (hasImage) context.drawImage(image.bitmap, x0, y0, imageWidth * scale, imageHeight * scale);
      const step = scene.pixelPerStep * scale;
      const line = (points, at, a, b) => {
        const [i, j] = [at + 2 * a, at + 2 * b];
        if (points[i] === NOT_A_NUMBER || points[j] === NOT_A_NUMBER) return;
        context.moveTo(x0 + points[i] * step, y0 + points[i + 1] * step);
        context.lineTo(x0 + points[j] * step, y0 + points[j + 1] * step);
      };
      context.lineWidth = dot;
      for (const person of scene.people) {
        const row = person.rowOfFrame[frame];
        if (row < 0) continue;
        const at = row * scene.joints.length * 2;
        scene.bones.forEach(([a, b], bone) => {
          context.beginPath();
          context.strokeStyle = person.state[row] & 3 ? scene.paleColour : person.boneColours[bone];
          line(person.image, at, a, b);
          context.stroke();
        });
        for (let joint = 0; joint < scene.joints.length; joint++) {
          const i = at + 2 * joint;
          if (!(person.inferred[row] >> joint & 1) || person.image[i] === NOT_A_NUMBER) continue;
          context.fillStyle = scene.inferredColour;
          context.beginPath();
          context.arc(x0 + person.image[i] * step, y0 + person.image[i + 1] * step, dot, 0, 2 * Math.PI);
          context.fill();
        }
      }
      for (const input of scene.keypoints) {
        const joints = input.names.length;
        for (let row = findLast(input.frames, frame - 1) + 1; input.frames[row] === frame; row++) {
          const at = row * joints * 2;
          for (const [colour, extra] of hasImage ? [['#ffffff', 1], ['#000000', 0]] : [['#000000', 0]]) {
            context.strokeStyle = context.fillStyle = colour;
            context.lineWidth = dot / 3 + extra;
            context.beginPath();
            for (const [a, b] of input.bones) line(input.points, at, a, b);
            context.stroke();
            const side = dot + 2 * extra;
            for (let i = at; i < at + 2 * joints; i += 2) {
              if (input.points[i] === NOT_A_NUMBER) continue;
              context.fillRect(x0 + input.points[i] * step - side / 2, y0 + input.points[i + 1] * step - side / 2, side, side);
            }
          }
        }
      }
      context.strokeStyle = '#999999';
      context.lineWidth = 1;
      context.strokeRect(x0, y0, imageWidth * scale, imageHeight * scale);
    }
  }

  // ---- curves -----------------------------------------------------------------------------------------------------

  const LEFT = 96; // px; room for the names of the curves
  const RIGHT = 10; // px
  const TOP = 6; // px; above the first curve
  const CURVE_GAP = 8; // px; between two curves
  const LANE = 13; // px; height of a row of states
  const AXIS = 42; // px; height of the axis of times and of the key below it

  class CurvesView {
    constructor(scene, goTo) {
      this.scene = scene;
      this.canvas = $('curves-view');
      const drag = (event) => {
        if (!(event.buttons & 1)) return;
        const share = (event.offsetX - LEFT) / (this.canvas.clientWidth - LEFT - RIGHT);
        goTo(this.begin + Math.min(Math.max(share, 0), 1) * (this.end - this.begin));
      };
      this.canvas.addEventListener('pointerdown', drag);
      this.canvas.addEventListener('pointermove', drag);
      this.layOut();
    }

    layOut() {
      const { scene } = this;
      this.begin = scene.seconds[0] ?? 0;
      this.end = Math.max(scene.seconds[scene.frameCount - 1] ?? 0, this.begin + 1e-3);
      // What is known of no person is left out.
      const isKnown = (key) => scene.people.some((person) => person[key].some((value) => value !== NOT_A_NUMBER));
      this.curves = [['residual, px', 'residual', scene.residualPerStep, 46], ['cadence, Hz', 'cadence', scene.cadencePerStep, 30]]
        .filter(([, key]) => isKnown(key));
      this.hasMotion = scene.people.some((person) => person.state.some((state) => state >> 4 & 3));
      this.lanes = ['motion', 'swaps undone', 'not detected', 'marks'].filter((name) => ({
        motion: this.hasMotion, 'swaps undone': scene.keypoints.length, 'not detected': true, marks: scene.marks.length,
      })[name]);
      this.laneTop = TOP + this.curves.reduce((sum, [, , , height]) => sum + height + CURVE_GAP, 0);
      this.axisTop = this.laneTop + LANE * this.lanes.length;
      $('curves').style.height = `${this.axisTop + AXIS}px`;
    }

    xOf(seconds) {
      return LEFT + (seconds - this.begin) / (this.end - this.begin) * (this.canvas.clientWidth - LEFT - RIGHT);
    }

    resize() {
      this.layOut();
      const context = fitCanvas(this.canvas);
      const { scene } = this;
      const width = this.canvas.clientWidth;
      context.clearRect(0, 0, width, this.canvas.clientHeight);
      context.font = '11px system-ui, sans-serif';
      context.textBaseline = 'middle';
      this.drawAxis(context, width, this.axisTop + 4);
      let top = TOP;
      for (const [name, key, unit, height] of this.curves) {
        this.drawCurve(context, name, key, unit, top, height);
        top += height + CURVE_GAP;
      }
      context.fillStyle = '#333333';
      this.lanes.forEach((name, i) => context.fillText(name, 6, this.laneTop + 5 + LANE * i));
      scene.people.forEach((person, index) => this.drawStates(context, person, index));
      for (const mark of scene.marks) {
        const x = this.xOf(mark.time);
        context.fillStyle = context.strokeStyle = mark.colour;
        context.beginPath();
        const y = this.laneTop + LANE * this.lanes.indexOf('marks') + 5;
        context.moveTo(x, y - 4); context.lineTo(x + 3, y); context.lineTo(x, y + 4); context.lineTo(x - 3, y);
        context.fill();
      }
      this.drawKey(context, width);
    }

    drawKey(context, width) {
      const motions = this.hasMotion ? MOTION_NAMES.map((name, i) => [name, MOTION_COLOURS[i]]) : [];
      const words = [...motions, ...this.scene.markKinds];
      context.textAlign = 'right';
      let x = width - RIGHT;
      for (const [name, colour] of words.reverse()) {
        context.fillStyle = '#555555';
        context.fillText(name, x, this.axisTop + 29);
        x -= context.measureText(name).width + 4;
        context.fillStyle = colour;
        context.fillRect(x - 9, this.axisTop + 25, 9, 9);
        x -= 20;
      }
      context.textAlign = 'left';
    }

    drawAxis(context, width, y) {
      const target = (width - LEFT - RIGHT) / 90;
      const steps = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 30, 60, 120, 300, 600, 1200, 3600];
      const step = steps.find((s) => (this.end - this.begin) / s <= target) || 7200;
      context.textAlign = 'center';
      for (let t = Math.ceil(this.begin / step) * step; t <= this.end; t += step) {
        const x = this.xOf(t);
        context.strokeStyle = '#eeeeee';
        context.beginPath(); context.moveTo(x, 4); context.lineTo(x, y - 4); context.stroke();
        context.fillStyle = '#666666';
        context.fillText(`${+t.toFixed(1)} s`, x, y + 11);
      }
      context.textAlign = 'left';
    }

    // Lowest and highest value in each column of pixels, so that long recordings keep their peaks.
    drawCurve(context, name, key, unit, top, height) {
      const { scene } = this;
      let highest = 0;
      for (const person of scene.people) {
        const known = person[key].filter((value) => value !== NOT_A_NUMBER).sort();
        if (known.length) highest = Math.max(highest, known[Math.floor((known.length - 1) * 0.995)]);
      }
      context.fillStyle = '#333333';
      context.fillText(name, 6, top + height / 2);
      if (!highest) return;
      const limit = highest * 1.05;
      context.fillStyle = '#888888';
      context.textAlign = 'right';
      context.fillText(`${+(highest * unit).toPrecision(2)}`, LEFT - 5, top + 4);
      context.textAlign = 'left';
      for (const person of scene.people) {
        context.strokeStyle = person.colour;
        context.lineWidth = 1;
        context.beginPath();
        let column = -1; let low = 0; let high = 0; let isDown = false;
        const yOf = (value) => top + height - Math.min(value / limit, 1) * height;
        const flush = () => {
          if (column < 0) return;
          if (isDown) context.lineTo(column, yOf(high)); else context.moveTo(column, yOf(high));
          context.lineTo(column, yOf(low));
          isDown = true;
        };
        let newest = -Infinity;
        person.frames.forEach((frame, row) => {
          const value = person[key][row];
          const isAfterGap = scene.seconds[frame] - newest > GAP_S;
          newest = scene.seconds[frame];
          if (isAfterGap || value === NOT_A_NUMBER) { flush(); column = -1; isDown = false; }
          if (value === NOT_A_NUMBER) return;
          const x = Math.round(this.xOf(scene.seconds[frame]) * 2) / 2;
          if (x !== column) { flush(); column = x; low = high = value; }
          low = Math.min(low, value); high = Math.max(high, value);
        });
        flush();
        context.stroke();
      }
    }

    drawStates(context, person, index) {
      const { scene } = this;
      const share = 9 / scene.people.length;
      const fill = (row, line, colour) => {
        const frame = person.frames[row];
        const x = Math.floor(this.xOf(scene.seconds[frame]));
        const next = Math.floor(this.xOf(scene.seconds[Math.min(frame + 1, scene.frameCount - 1)]));
        context.fillStyle = colour;
        if (line >= 0) context.fillRect(x, this.laneTop + LANE * line + share * index, Math.max(next - x, 1), share);
      };
      const [motion, swaps, absent] = ['motion', 'swaps undone', 'not detected'].map((name) => this.lanes.indexOf(name));
      person.state.forEach((state, row) => {
        fill(row, motion, MOTION_COLOURS[state >> 4 & 3]);
        if (state & 4) fill(row, swaps, person.colour);
        if (state & 1) fill(row, absent, person.colour);
      });
    }

    update(seconds) { $('cursor').style.transform = `translateX(${this.xOf(seconds)}px)`; }
  }

  // ---- the page ---------------------------------------------------------------------------------------------------

  // The first time at which a person is seen and not tentative: a better first sight than a pale person.
  function findFirstCertainTime(scene) {
    let first = Infinity;
    for (const person of scene.people) {
      const row = person.state.findIndex((state) => !(state & 3));
      if (row >= 0) first = Math.min(first, scene.seconds[person.frames[row]]);
    }
    return first === Infinity ? 0 : first;
  }

  async function start() {
    if (!window.DecompressionStream) return fail('This browser is too old for this page; any of 2023 or later opens it.');
    const read = readScene(await inflate($('data').textContent.trim()));
    const scene = read.liveTopic ? new LiveScene(read) : read;
    let frame = 0;
    let seconds = 0;
    let isPlaying = false;
    let isStale = true;
    let before = 0;
    let slowFrames = 0;
    let hasJumped = true; // whether the view goes at once to where the people are
    const refresh = () => { isStale = true; };
    let space;
    try {
      space = new SpaceView(scene, refresh);
    } catch (error) {
      return fail(`This page needs WebGL, which the browser does not offer (${error.message}).`);
    }
    const image = new ImageView(scene, refresh);
    const goTo = (time) => {
      if (Math.abs(time - seconds) > JUMP_S) hasJumped = true;
      seconds = Math.min(Math.max(time, scene.seconds[0] ?? 0), scene.seconds[scene.frameCount - 1] ?? 0);
      frame = Math.max(findLast(scene.seconds, seconds + 1e-6), 0);
      isStale = true;
    };
    const curves = new CurvesView(scene, goTo);
    $('title').textContent = document.title = scene.title;
    for (const [name, colour] of scene.colourKey) {
      const key = $('colours').appendChild(document.createElement('span'));
      key.className = 'key';
      key.style.background = colour;
      key.textContent = name;
      $('colours').append(' ');
    }
    $('time').max = scene.frameCount - 1;
    $('clouds').parentElement.hidden = !scene.isLive && !scene.people.some((person) => person.std.some((std) => std !== 255));

    let silence = ''; // why nothing moves in a live scene
    const showSilence = () => {
      const reason = isPlaying && scene.isLive ? scene.explainSilence() : '';
      if (reason === silence) return;
      $('silence').textContent = silence = reason;
      document.body.classList.toggle('silent', Boolean(reason));
      refresh();
    };
    const show = () => {
      if (!scene.frameCount) return;
      space.update(frame);
      image.update(frame);
      curves.update(seconds);
      $('time').value = frame;
      $('clock').textContent = scene.isLive ? `${seconds.toFixed(2)} s${isPlaying && !silence ? describePace() : ''}`
        : `${seconds.toFixed(2)} s (${frame + 1} / ${scene.frameCount})`;
    };
    // Frames per second and the delay, where the stamps are of this clock, of the last frames of a live scene.
    const describePace = () => {
      const first = Math.max(scene.frameCount - PACE_FRAMES, 0);
      const lastS = scene.seconds[scene.frameCount - 1] - scene.seconds[first];
      const rate = lastS > 0 ? `, ${((scene.frameCount - 1 - first) / lastS).toFixed(0)} Hz` : '';
      const recent = delays.slice(-PACE_FRAMES).sort((a, b) => a - b);
      const delay = recent[recent.length >> 1];
      return `, live${rate}${delay > 0 && delay < MAX_DELAY_MS ? `, ${delay.toFixed(0)} ms` : ''}`;
    };
    const setPlaying = (value) => {
      isPlaying = value;
      space.setMoving(value);
      refresh();
      $('play').innerHTML = value ? '&#10074;&#10074;' : '&#9654;';
      if (value && (scene.isLive || frame === scene.frameCount - 1)) goTo(scene.isLive ? Infinity : 0);
    };
    let isNew = false; // whether the newest frame of a live scene has not been drawn
    let mostPeople = 0;
    let curvesMs = -Infinity; // when the curves of a live scene were drawn
    const delays = []; // ms from the stamp to the picture, of the frames of a live scene that were drawn
    const takeFrame = (received) => {
      const isFirst = !scene.frameCount;
      const removed = scene.add(received);
      $('time').max = scene.frameCount - 1;
      space.placeFloorAndCamera();
      goTo(isPlaying ? Infinity : seconds);
      isNew = true;
      if (isFirst || (received.ids.length > mostPeople && space.view)) { // all are in sight
        space.update(frame);
        space.choose(space.view ?? 'free');
        mostPeople = received.ids.length;
      }
      if (removed || performance.now() - curvesMs > CURVES_S * 1000) {
        curvesMs = performance.now();
        image.explain();
        const height = $('curves').clientHeight;
        curves.resize();
        if ($('curves').clientHeight !== height) resize();
      }
    };
    const tick = (now) => {
      const elapsed = now - before;
      before = now;
      showSilence();
      if (isPlaying && !scene.isLive) {
        const end = scene.seconds[scene.frameCount - 1];
        const next = seconds + Math.min(elapsed, 500) / 1000 * Number($('speed').value);
        goTo(next > end ? 0 : next); // starts again, as an animation does
      }
      if (isPlaying) {
        slowFrames = elapsed > SLOW_FRAME_MS ? slowFrames + 1 : 0;
        if (slowFrames > (elapsed > VERY_SLOW_FRAME_MS ? 2 : 10)) { space.lowerResolution(); slowFrames = 0; }
      }
      if (isStale) {
        show();
        isStale = !space.follow(hasJumped ? Infinity : elapsed / 1000);
        hasJumped = false;
        space.draw(frame);
        pictures++;
        if (isNew && isPlaying) {
          delays.push(performance.timeOrigin + performance.now() - scene.startMs - 1000 * scene.seconds[frame]);
          if (delays.length > LIVE_FRAMES) delays.shift();
        }
        isNew = false;
      }
      requestAnimationFrame(tick);
    };
    let pictures = 0;
    const resize = () => { space.resize(); image.resize(); curves.resize(); isStale = true; };
    window.addEventListener('resize', resize);
    $('play').addEventListener('click', () => setPlaying(!isPlaying));
    $('time').addEventListener('input', () => goTo(scene.seconds[Number($('time').value)]));
    for (const id of ['follow', 'clouds', 'joint-names']) $(id).addEventListener('change', refresh);
    for (const button of document.querySelectorAll('[data-view]')) {
      button.addEventListener('click', () => { space.choose(button.dataset.view); refresh(); });
    }
    window.addEventListener('keydown', (event) => {
      const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
      if (event.key === ' ') setPlaying(!isPlaying);
      else if (step) goTo(scene.seconds[Math.min(Math.max(frame + step, 0), scene.frameCount - 1)]);
      else return;
      event.preventDefault();
    });
    resize();
    $('speed').hidden = scene.isLive;
    if (scene.isLive) {
      scene.receive(takeFrame);
    } else {
      goTo(findFirstCertainTime(scene));
      space.update(frame);
      space.choose('free');
    }
    requestAnimationFrame(tick);

    // For tests and for pictures of the page.
    window.mocapPage = {
      scene,
      play: () => setPlaying(true),
      pause: () => setPlaying(false),
      view: (name) => { space.choose(name); refresh(); },
      pictures: () => pictures,
      pixelRatio: () => space.ratio,
      delays: () => delays,
      imageFrame: () => image.shown,
      target: () => space.controls.target.toArray(),
      // Draw the frame at this time at once; return what was drawn.
      showTime: (time) => {
        setPlaying(false);
        goTo(time);
        show();
        space.follow(Infinity);
        space.controls.update();
        space.draw(frame);
        return {
          frame,
          people: scene.people.flatMap((person) => {
            const row = person.rowOfFrame[frame];
            if (row < 0) return [];
            const point = new THREE.Vector3();
            return [{ id: person.id, joints: scene.joints.map((_, j) => space.jointOf(person, row, j, point).toArray()) }];
          }),
          jointsDrawn: space.joints.count,
          bonesDrawn: space.bones.count,
          target: window.mocapPage.target(),
          rows: [...curves.curves.map(([name]) => name), ...curves.lanes],
          // Place of each joint over the floor in the frame in which y is up, m.
          heights: scene.people.flatMap((person) => {
            const row = person.rowOfFrame[frame];
            if (row < 0) return [];
            const point = new THREE.Vector3();
            return [scene.joints.map((_, j) => space.toSpace(space.jointOf(person, row, j, point)).y + scene.floorY)];
          }),
          cloudsDrawn: space.clouds.count,
        };
      },
    };
    document.body.dataset.ready = 'true';
    if (location.hash !== '#pause') setPlaying(true);
  }

  start().catch((error) => fail(`The page cannot be shown: ${error.message}`));
})();
