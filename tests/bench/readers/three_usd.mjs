// What three.js makes of a USD file: animations, tracks, bones. In a folder with
// three installed (npm install three):
//   node three_usd.mjs walk.usdc
import { readFileSync } from "node:fs";

// The loader asks for these of a browser and uses neither for skeletons.
globalThis.self = globalThis;
globalThis.document = { createElementNS: () => ({ style: {}, addEventListener() {} }) };

const { USDLoader } = await import("three/examples/jsm/loaders/USDLoader.js");
const bytes = readFileSync(process.argv[2]);
const buffer = bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.byteLength);
const scene = new USDLoader().parse(buffer);

let bones = 0;
scene.traverse((object) => {
  bones += object.isBone ? 1 : 0;
});
for (const clip of scene.animations) {
  console.log(
    `${clip.name}: ${clip.tracks.length} tracks, ${clip.tracks[0].times.length} keys, ` +
      `${clip.duration.toFixed(4)} s, ${bones} bones`,
  );
}
