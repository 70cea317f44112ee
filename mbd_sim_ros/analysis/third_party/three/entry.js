// Parts of three.js that view/scene.js uses; docs/tools/three.py makes three.min.js of them.
export {
  BufferAttribute, BufferGeometry, Color, CylinderGeometry, DirectionalLight, HemisphereLight, InstancedBufferAttribute,
  InstancedMesh, LineBasicMaterial, LineSegments, MeshLambertMaterial, OrthographicCamera, PerspectiveCamera, Scene, WebGLRenderer,
} from 'three';
