// three-vrm opens take.vrm and plays take.vrma on it; Khronos' validator looks at all three glTF files of the folder. Writes where the bones' joints are:
// vrm.json, by bone and frame, metres, y up, the figure looks along +z.
import { readFileSync, writeFileSync } from 'node:fs'
import { VRMLoaderPlugin } from '@pixiv/three-vrm'
import { VRMAnimationLoaderPlugin, createVRMAnimationClip } from '@pixiv/three-vrm-animation'
import validator from 'gltf-validator'
import * as THREE from 'three'
import { GLTFLoader } from 'three/addons/loaders/GLTFLoader.js'

// The loader asks a browser for these two.
globalThis.self ??= globalThis
globalThis.ProgressEvent ??= class {}

const truth = JSON.parse(readFileSync('truth.json'))
const loader = new GLTFLoader()
loader.register((parser) => new VRMLoaderPlugin(parser))
loader.register((parser) => new VRMAnimationLoaderPlugin(parser))
const open = (file) => {
  const bytes = readFileSync(file)
  return loader.parseAsync(bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.byteLength), '')
}

/** Joints of a model while a clip is played on it. */
function played(vrm, clip) {
  const mixer = new THREE.AnimationMixer(vrm.scene)
  mixer.clipAction(clip).play()
  const found = {}
  for (const frame of truth.frames) {
    // A little before the end, where a clip would begin anew.
    mixer.setTime(Math.min(frame / truth.rate_hz, clip.duration - 1e-6))
    vrm.humanoid.update()
    vrm.scene.updateMatrixWorld(true)
    for (const bone of Object.keys(vrm.humanoid.humanBones)) {
      const at = vrm.humanoid.getRawBoneNode(bone).getWorldPosition(new THREE.Vector3())
      ;(found[bone] ??= []).push(at.toArray())
    }
  }
  return found
}

const model = await open('take.vrm')
const { vrm } = model.userData
if (vrm?.meta.metaVersion !== '1') throw new Error('take.vrm is no VRM 1.0')
// Its own movement is of the bones themselves, which the humanoid would put back.
vrm.humanoid.autoUpdateHumanBones = false
const own = played(vrm, model.animations[0])
const other = (await open('take.vrm')).userData.vrm
const [animation] = (await open('take.vrma')).userData.vrmAnimations
writeFileSync('vrm.json', JSON.stringify({ 'take.vrm': own, 'take.vrma': played(other, createVRMAnimationClip(animation, other)) }))

for (const file of ['take.glb', 'take.vrm', 'take.vrma']) {
  const { issues } = await validator.validateBytes(new Uint8Array(readFileSync(file)))
  console.log(`${file}: ${issues.numErrors} errors, ${issues.numWarnings} warnings (gltf-validator)`)
  if (issues.numErrors > 0 || issues.numWarnings > 0) {
    console.error(JSON.stringify(issues.messages, null, 1))
    process.exitCode = 1
  }
}
