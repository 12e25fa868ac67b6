// What three.js makes of a GLB, as JSON: positions of nodes and points over time.
// In a folder with three installed (npm install three):
//   node three_gltf.mjs fox.glb OUT.json CLIP TIME…
// Times are in seconds. It reads four joints of a vertex, not more.
import { readFileSync, writeFileSync } from "node:fs";
import { pathToFileURL } from "node:url";
import path from "node:path";

globalThis.self = globalThis;

// The package is that of the folder that this runs in, not of this file.
const load = (name) => import(pathToFileURL(path.resolve("node_modules/three", name)).href);
const THREE = await load("build/three.module.js");
const { GLTFLoader } = await load("examples/jsm/loaders/GLTFLoader.js");

const MAX_POINTS = 50;
const [file, output, name, ...times] = process.argv.slice(2);
const bytes = readFileSync(file);
const buffer = bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.byteLength);
const made = await new GLTFLoader().parseAsync(buffer, "");
const joints = {};
const points = {};
const clip = made.animations.find((one) => one.name === name);
const mixer = new THREE.AnimationMixer(made.scene);
if (clip) {
  const action = mixer.clipAction(clip);
  action.setLoop(THREE.LoopOnce);
  action.clampWhenFinished = true;
  action.play();
}
for (const time of times) {
  mixer.setTime(Number(time));
  made.scene.updateMatrixWorld(true);
  made.scene.traverse((object) => {
    // Names of the file; the loader changes those that its paths cannot hold.
    const own = object.userData.name ?? object.name;
    if (object.isMesh) {
      const count = object.geometry.attributes.position.count;
      const step = Math.floor(count / MAX_POINTS) + 1;
      const places = [];
      for (let i = 0; i < count; i += step) {
        const place = object.getVertexPosition(i, new THREE.Vector3());
        places.push(place.applyMatrix4(object.matrixWorld).toArray());
      }
      (points[own] ??= []).push(places);
    } else {
      const place = new THREE.Vector3().setFromMatrixPosition(object.matrixWorld);
      (joints[own] ??= []).push(place.toArray());
    }
  });
}
const clips = made.animations.map((one) => one.name);
writeFileSync(output, JSON.stringify({ joints, points, clips }));
