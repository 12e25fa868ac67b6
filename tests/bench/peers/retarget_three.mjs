// three.js' retargetClip in node. Prints its seconds as JSON.
// node retarget_three.mjs CASE FOLDER OUT; FOLDER is that of the package three.
import { readFileSync, writeFileSync } from "node:fs";
import { resolve } from "node:path";
import { performance } from "node:perf_hooks";
import { pathToFileURL } from "node:url";

const [file, folder, out] = process.argv.slice(2);
// The utilities import "three" by name, which leads to the same file.
const load = (path) => import(pathToFileURL(resolve(folder, path)));
const THREE = await load("build/three.module.js");
const { retargetClip } = await load("examples/jsm/utils/SkeletonUtils.js");
const asked = JSON.parse(readFileSync(file, "utf8"));

function mesh(joints, letter) {
  const bones = joints.map((joint, j) => {
    const bone = new THREE.Bone();
    bone.name = `${letter}${j}`;
    bone.position.fromArray(joint.offset);
    bone.quaternion.fromArray(joint.rest);
    return bone;
  });
  const skinned = new THREE.SkinnedMesh(new THREE.BufferGeometry());
  joints.forEach((joint, j) =>
    (joint.parent < 0 ? skinned : bones[joint.parent]).add(bones[j]));
  skinned.updateMatrixWorld(true);
  skinned.bind(new THREE.Skeleton(bones));
  return skinned;
}

const source = mesh(asked.source, "s");
const target = mesh(asked.target, "t");
const count = asked.root.length;
const times = Float32Array.from({ length: count }, (_, f) => f / asked.fps);
const tracks = asked.source.map((_, j) => new THREE.QuaternionKeyframeTrack(
  `.bones[s${j}].quaternion`, times, asked.rotations.flatMap((row) => row[j])));
tracks.push(new THREE.VectorKeyframeTrack(
  ".bones[s0].position", times, asked.root.flat()));
const clip = new THREE.AnimationClip("take", -1, tracks);

// How a bone is turned from that of the source: rests differ.
const names = {}, localOffsets = {};
asked.follows.forEach((first, j) => {
  if (first < 0) return;
  const rest = new THREE.Quaternion();
  source.skeleton.bones[first].getWorldQuaternion(rest);
  rest.invert().multiply(new THREE.Quaternion().fromArray(asked.aligned[j]));
  names[`t${j}`] = `s${first}`;
  localOffsets[`t${j}`] = new THREE.Matrix4().makeRotationFromQuaternion(rest);
});
const options = { hip: `s${asked.follows[0]}`, names, localOffsets, scale: asked.scale };

const began = performance.now();
const spent = process.cpuUsage();
const made = retargetClip(target, source, clip, options);
const wall = (performance.now() - began) / 1e3;
const { user, system } = process.cpuUsage(spent);

const mixer = new THREE.AnimationMixer(target);
const action = mixer.clipAction(made);
action.setLoop(THREE.LoopOnce);
action.clampWhenFinished = true;
action.play();
const place = new THREE.Vector3();
const positions = Array.from(times, (time) => {
  mixer.setTime(time);
  target.updateMatrixWorld(true);
  return target.skeleton.bones.map((bone) => bone.getWorldPosition(place).toArray());
});
writeFileSync(out, JSON.stringify(positions));
console.log("\n" + JSON.stringify({ taken: [[wall, (user + system) / 1e6]] }));
