// The surfaces of shapes in space, drawn by three.js into the canvas behind an SVG that report.js draws the rest into. What S is:
// reports/page_data.hpp. Nothing where the browser has no WebGL: then gnuplot's figure stands there.
const taut_space = S => {
  'use strict';
  const probe = document.createElement('canvas');
  if (!probe.getContext('webgl2') && !probe.getContext('webgl')) return null;
  // One renderer serves all canvases: browsers allow a few only.
  const renderer = new THREE.WebGLRenderer({antialias: true, alpha: true, preserveDrawingBuffer: true});

  // Places in steps: each state as the difference to the one before.
  let sum = null;
  const places = S.states.map(state => {
    sum = sum ? sum.map((v, i) => v + state.points[i]) : state.points;
    return Float32Array.from(sum);
  });
  const resting = S.states.findIndex(state => state.label.startsWith('rest')), first = places[Math.max(resting, 0)];

  /// Edges of the body: where two facets meet at an angle, or two materials do.
  const edges = (() => {
    const T = S.triangles, seen = new Map(), list = [];
    const corner = i => new THREE.Vector3(first[3 * i], first[3 * i + 1], first[3 * i + 2]);
    for (let t = 0; t < T.length; t += 3) {
      const [a, b, c] = [corner(T[t]), corner(T[t + 1]), corner(T[t + 2])];
      const normal = b.sub(a).cross(c.sub(a)).normalize();
      for (let e = 0; e < 3; ++e) {
        const [i, j] = [T[t + e], T[t + (e + 1) % 3]], key = Math.min(i, j) + ' ' + Math.max(i, j), other = seen.get(key);
        if (!other) seen.set(key, {normal, region: S.triangle_regions[t / 3], i, j});
        else {
          seen.delete(key);
          if (other.normal.dot(normal) < 0.86 || other.region !== S.triangle_regions[t / 3]) list.push(i, j);
        }
      }
    }
    for (const {i, j} of seen.values()) list.push(i, j);
    return list;
  })();

  const scene = new THREE.Scene(), camera = new THREE.OrthographicCamera(-1, 1, 1, -1, -1, 1);
  const light = new THREE.DirectionalLight(0xffffff, 0.42);
  scene.add(new THREE.AmbientLight(0xffffff, 0.6), light, light.target);
  const now = new THREE.BufferAttribute(new Float32Array(first.length), 3);
  S.regions.forEach((region, r) => {
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute('position', now);
    geometry.setIndex(S.triangles.filter((_, i) => S.triangle_regions[Math.floor(i / 3)] === r));
    const body = new THREE.Mesh(geometry, new THREE.MeshPhongMaterial({color: region.colour, flatShading: true, shininess: 0,
      polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 1}));
    body.frustumCulled = false;
    scene.add(body);
  });
  function lines(attribute) {
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute('position', attribute);
    geometry.setIndex(edges);
    const drawn = new THREE.LineSegments(geometry, new THREE.LineBasicMaterial());
    drawn.frustumCulled = false;
    scene.add(drawn);
    return drawn;
  }
  const outline = lines(now), rest = lines(new THREE.BufferAttribute(first, 3));

  return {
    /// Paints state k: unit vectors of the view and its middle in steps, pixels per step, and how far the middle is moved.
    paint(canvas, k, {right, up, toward, middle, scale, x, y, width, height, ink, grey}) {
      now.array.set(places[k]);
      now.needsUpdate = true;
      outline.material.color.set(ink);
      rest.material.color.set(grey);
      rest.visible = resting >= 0 && resting !== k;
      const [R, U, Z] = [right, up, toward].map(v => new THREE.Vector3(...v)), target = new THREE.Vector3(...middle);
      target.addScaledVector(R, x).addScaledVector(U, y);
      const far = 1e5;
      camera.position.copy(target).addScaledVector(Z, far / 2);
      camera.up.copy(U);
      camera.lookAt(target);
      Object.assign(camera, {left: -width / 2 / scale, right: width / 2 / scale, top: height / 2 / scale, bottom: -height / 2 / scale,
        near: 0, far});
      camera.updateProjectionMatrix();
      light.target.position.copy(target);
      light.position.copy(target).addScaledVector(R, -0.4).addScaledVector(U, 0.7).addScaledVector(Z, 0.6);
      const ratio = window.devicePixelRatio || 1;
      renderer.setPixelRatio(ratio);
      renderer.setSize(width, height, false);
      renderer.render(scene, camera);
      canvas.width = renderer.domElement.width;
      canvas.height = renderer.domElement.height;
      canvas.getContext('2d').drawImage(renderer.domElement, 0, 0);
    },
    /// Where point i of state k is [steps].
    place: (k, i) => Array.from(places[k].subarray(3 * i, 3 * i + 3)),
    places
  };
};
