// What three.js makes of a USD file, as JSON: joints and points over time.
// In a folder with three installed (npm install three):
//   node three_usd.mjs walk.usdc OUT.json FPS CODE…
// Positions are in metres, y up: the loader converts both.
import { readFileSync, writeFileSync } from "node:fs";
import { pathToFileURL } from "node:url";
import path from "node:path";

// The loader asks for these of a browser and uses neither for skeletons.
globalThis.self = globalThis;
globalThis.document = { createElementNS: () => ({ style: {}, addEventListener() {} }) };

// The package is that of the folder that this runs in, not of this file.
const load = (name) => import(pathToFileURL(path.resolve("node_modules/three", name)).href);
const THREE = await load("build/three.module.js");
const { USDLoader } = await load("examples/jsm/loaders/USDLoader.js");

const MOST_POINTS = 50;
const [file, output, fps, ...codes] = process.argv.slice(2);
const bytes = readFileSync(file);
const buffer = bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.byteLength);
const scene = new USDLoader().parse(buffer);

const joints = {};
const points = {};
const clips = scene.animations ?? [];
const mixer = new THREE.AnimationMixer(scene);
for (const clip of clips.slice(0, 1)) {
  const action = mixer.clipAction(clip);
  action.setLoop(THREE.LoopOnce);
  action.clampWhenFinished = true;
  action.play();
}
for (const code of codes) {
  mixer.setTime(Number(code) / Number(fps));
  scene.updateMatrixWorld(true);
  scene.traverse((object) => {
    if (object.isBone) {
      const place = new THREE.Vector3().setFromMatrixPosition(object.matrixWorld);
      (joints[object.name] ??= []).push(place.toArray());
    } else if (object.isMesh && !object.isSkinnedMesh && object.geometry.attributes.position) {
      const own = object.geometry.attributes.position;
      const step = Math.floor(own.count / MOST_POINTS) + 1;
      const places = [];
      for (let i = 0; i < own.count; i += step) {
        const place = new THREE.Vector3().fromBufferAttribute(own, i);
        places.push(place.applyMatrix4(object.matrixWorld).toArray());
      }
      (points[object.name] ??= []).push(places);
    }
  });
}
const keys = Math.max(0, ...clips.flatMap((c) => c.tracks.map((t) => t.times.length)));
const range = clips.length ? [0, clips[0].duration * Number(fps)] : [0, 0];
writeFileSync(output, JSON.stringify({ joints, points, frames: range, keys }));
