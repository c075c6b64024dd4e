// Models as other programs write and read them: OBJ, PLY, STL, glTF, COLLADA, FBX, 3MF and more, through assimp; and
// meshes as glTF for any viewer.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "iris/types/triangle_mesh.h"

namespace iris::exporters {

// The surfaces of a file, a mesh for each of its parts, in the file's own axes and unit; glTF, which is always y up, is
// turned z up:
//   * everything is made of triangles; the nodes' transforms are applied; lines and points are left out;
//   * names are those of the nodes, or of the meshes;
//   * texture: the colour (diffuse) image of the material, inside the file or beside it, times the material's colour;
//     an image that is missing or cannot be read gives the material's colour, and a warning;
//   * colours of vertices are kept where there is no texture; `colour` is their mean.
// Throws InputError if the file is missing, is no model, or has no triangle.
std::vector<TriangleMesh> read_meshes(const std::filesystem::path& path);

struct GlbOptions {
  int jpeg_quality = 90;  // of the textures; 0 = PNG: exact, larger
};

// Binary glTF of meshes in a z-up world: the node `world` turns z up to glTF's y up; below it a node for each mesh,
// with its name. Textures repeat; meshes that share a texture share its image. Colours, of vertices too, show as they
// are, whatever the light (KHR_materials_unlit). Meshes without triangles have no node. The same meshes give the same
// bytes.
std::string encode_glb(const std::vector<TriangleMesh>& meshes, const GlbOptions& options = {});

// Throws InputError if the file cannot be written; never leaves half a file.
void write_glb(const std::filesystem::path& path, const std::vector<TriangleMesh>& meshes,
               const GlbOptions& options = {});

// One surface without texture, as assimp writes it (but for .ply); the format is that of the name: .ply (binary), .obj,
// .stl (binary), .fbx (text), .3mf, .x3d, .dae; or .glb as above. Metres, z up, but for .glb. Vertex colours where the
// format has them (not in .stl, .3mf). Throws UsageError for another name, InputError if the file cannot be written;
// never leaves half a file.
void write_mesh(const std::filesystem::path& path, const TriangleMesh& mesh);

}  // namespace iris::exporters
