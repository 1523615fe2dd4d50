"""Write an example beside an exported file: a scene, a page or a script that shows the material on a sphere.

``FILE`` in a template is the exported file, and ``SELF`` is the example. All examples have a similar sphere and lights.
"""

from html import escape
from json import dumps
from pathlib import Path

from dsbrdf.errors import InvalidArgumentError, one_of
from dsbrdf.output.export.single_precision import filled

_MITSUBA = """\
<!-- mitsuba -m VARIANT SELF -->
<scene version="3.0.0">
  <integrator type="path"/>
  <sensor type="perspective">
    <float name="fov" value="32"/>
    <transform name="to_world">
      <lookat origin="0, 0, 4" target="0, 0, 0" up="0, 1, 0"/>
    </transform>
    <film type="hdrfilm">
      <integer name="width" value="256"/>
      <integer name="height" value="256"/>
    </film>
    <sampler type="independent">
      <integer name="sample_count" value="64"/>
    </sampler>
  </sensor>
  <emitter type="constant">
    <rgb name="radiance" value="0.3"/>
  </emitter>
  <shape type="sphere">
    <point name="center" x="4" y="5" z="6"/>
    <float name="radius" value="1.5"/>
    <emitter type="area">
      <rgb name="radiance" value="12"/>
    </emitter>
  </shape>
  <shape type="sphere">
    <bsdf type="measured">
      <string name="filename" value="FILE"/>
    </bsdf>
  </shape>
</scene>
"""

_PBRT = """\
# pbrt SELF
Scale -1 1 1  # This makes the system right-handed.
LookAt 0 0 4  0 0 0  0 1 0
Camera "perspective" "float fov" 32
Film "rgb" "integer xresolution" 256 "integer yresolution" 256 "string filename" "STEM.exr"
Sampler "halton" "integer pixelsamples" 64
Integrator "path"

WorldBegin
LightSource "infinite" "rgb L" [ 0.3 0.3 0.3 ]
AttributeBegin
  Translate 4 5 6
  AreaLightSource "diffuse" "rgb L" [ 12 12 12 ]
  Shape "sphere" "float radius" 1.5
AttributeEnd
Material "measured" "string filename" "FILE"
Shape "sphere" "float radius" 1
"""

_THREE = """\
<!doctype html>
<title>STEM</title>
<style>
body { margin: 0; background: black; color: white; font: 1rem sans-serif; }
canvas { display: block; }
p { margin: 3rem; }
</style>
<template id="offline">
  <p>This page needs three.js, and its address cannot be reached. Go online and load the page again. To use it without a
    network, download three.module.js and three.core.js of three.js, serve them in the folder of this page, and write
    "./three.module.js" for the address in the import map.</p>
</template>
<script type="importmap">
{ "imports": { "three": "https://cdn.jsdelivr.net/npm/three@0.187.0/build/three.module.js" } }
</script>
<script id="vertex" type="x-shader">
out vec3 seenNormal, seenPlace;
void main() {
  vec4 place = modelViewMatrix * vec4(position, 1.0);
  seenPlace = place.xyz;
  seenNormal = normalMatrix * normal;
  gl_Position = projectionMatrix * place;
}
</script>
<script id="fragment" type="x-shader">
in vec3 seenNormal, seenPlace;
uniform vec3 light;  // direction to a distant light, in the camera's frame
out vec4 color;

SHADER
void main() {
  vec3 normal = normalize(seenNormal), across = normalize(cross(vec3(0.0, 1.0, 0.0), normal));
  mat3 frame = mat3(across, cross(normal, across), normal);
  vec3 omega_in = normalize(light * frame), omega_out = normalize(-seenPlace * frame);
  vec3 radiance = 3.0 * FUNCTION(omega_in, omega_out) * max(omega_in.z, 0.0);
  color = vec4(mix(12.92 * radiance, 1.055 * pow(radiance, vec3(1.0 / 2.4)) - 0.055, step(0.0031308, radiance)), 1.0);
}
</script>
<script type="module">
const THREE = await import("three").catch((error) => {
  document.body.append(document.getElementById("offline").content);
  throw error;
});
const text = (id) => document.getElementById(id).textContent;
const light = new THREE.Vector3(0.4, 0.5, 0.7).normalize();
const material = new THREE.ShaderMaterial({
  glslVersion: THREE.GLSL3,
  uniforms: { light: { value: light } },
  vertexShader: text("vertex"),
  fragmentShader: text("fragment"),
});
const renderer = new THREE.WebGLRenderer({ antialias: true });
const scene = new THREE.Scene().add(new THREE.Mesh(new THREE.SphereGeometry(1, 128, 64), material));
const camera = new THREE.PerspectiveCamera(32, 1, 1, 10);
camera.position.z = 4;
document.body.append(renderer.domElement);
const draw = () => {
  renderer.setSize(innerWidth, innerHeight);
  camera.aspect = innerWidth / innerHeight;
  camera.updateProjectionMatrix();
  renderer.render(scene, camera);
};
addEventListener("resize", draw);
addEventListener("pointermove", (event) => {  // The light follows the pointer.
  const [x, y] = [2 * event.clientX / innerWidth - 1, 1 - 2 * event.clientY / innerHeight];
  light.set(2 * x, 2 * y, 1).normalize();
  draw();
});
draw();
</script>
"""

_BLENDER = """\
# blender --python SELF
from pathlib import Path
from xml.etree import ElementTree

import bpy

SOCKETS = {  # inputs of OpenPBR and of Blender's Principled BSDF
    "base_color": "Base Color",
    "base_metalness": "Metallic",
    "specular_color": "Specular Tint",
    "specular_roughness": "Roughness",
    "specular_ior": "IOR",
    "coat_weight": "Coat Weight",
    "coat_roughness": "Coat Roughness",
    "coat_ior": "Coat IOR",
}
document = ElementTree.parse(Path(__file__).with_name("FILE"))
surface = document.find("open_pbr_surface")
bpy.ops.object.select_all(action="SELECT")
bpy.ops.object.delete()
bpy.ops.mesh.primitive_uv_sphere_add(segments=128, ring_count=64)
bpy.ops.object.shade_smooth()
material = bpy.data.materials.new(document.find("surfacematerial").get("name"))
material.use_nodes = True
bpy.context.object.data.materials.append(material)
principled = material.node_tree.nodes["Principled BSDF"]
for name, socket in SOCKETS.items():
    numbers = [float(text) for text in surface.find(f"input[@name='{name}']").get("value").split(",")]
    principled.inputs[socket].default_value = (*numbers, 1.0) if len(numbers) == 3 else numbers[0]
bpy.ops.object.light_add(type="AREA", radius=3.0, location=(4.0, -6.0, 5.0), rotation=(0.97, 0.0, 0.59))
bpy.context.object.data.energy = 2000.0
bpy.ops.object.camera_add(location=(0.0, -4.0, 0.0), rotation=(1.5708, 0.0, 0.0))
bpy.context.scene.camera = bpy.context.object
"""

EXAMPLES = {
    "glsl": ("html", _THREE),
    "bsdf": ("xml", _MITSUBA.replace("VARIANT", "scalar_rgb")),
    "bsdf-spectral": ("pbrt", _PBRT),
    "materialx": ("py", _BLENDER),
}
"""Format -> suffix and template of its example."""


def example(path: Path, file_format: str, content: bytes, name: str) -> tuple[Path, bytes]:
    """Return the path and the text of an example that shows an exported file; `name` names its function.

    Raises InvalidArgumentError if the format has no example.
    """
    if file_format not in EXAMPLES:
        raise InvalidArgumentError(f"there is an example for {one_of(list(EXAMPLES))}, not for {file_format}")
    suffix, text = EXAMPLES[file_format]
    beside = path.with_suffix(f".{suffix}")
    words = {"SELF": beside.name, "STEM": path.stem, "FILE": path.name}
    quoted = {word: escape(file) if suffix in ("html", "xml") else dumps(file)[1:-1] for word, file in words.items()}
    shader = content.decode() if file_format == "glsl" else ""
    return beside, filled(text, quoted | {"FUNCTION": name, "SHADER": shader}).encode()
