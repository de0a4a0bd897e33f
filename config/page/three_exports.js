// What the page uses of three.js; everything else is left out of the bundle.
export {
  BufferAttribute, BufferGeometry, Color, CylinderGeometry, DirectionalLight, GridHelper, Group, HemisphereLight,
  IcosahedronGeometry, InstancedMesh, LineBasicMaterial, LineSegments, Matrix4, MeshBasicMaterial,
  MeshLambertMaterial, PerspectiveCamera, Quaternion, Scene, Vector3, WebGLRenderer,
} from 'three';
export { OrbitControls } from 'three/addons/controls/OrbitControls.js';
