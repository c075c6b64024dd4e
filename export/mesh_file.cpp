#include "export/mesh_file.h"

#include <assimp/material.h>
#include <assimp/postprocess.h>
#include <assimp/scene.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <assimp/Exporter.hpp>
#include <assimp/Importer.hpp>
#include <cmath>
#include <map>
#include <memory>
#include <opencv2/imgcodecs.hpp>
#include <sstream>

#include "export/colours.h"
#include "export/gltf_builder.h"
#include "iris/core/atomic_file.h"
#include "iris/core/error.h"

namespace iris::exporters {

namespace {

namespace fs = std::filesystem;

Eigen::Matrix4d matrix_of(const aiMatrix4x4& m) {
  Eigen::Matrix4d result;
  for (unsigned y = 0; y < 4; ++y) {
    for (unsigned x = 0; x < 4; ++x) result(y, x) = m[y][x];
  }
  return result;
}

// What of a material is used.
struct Look {
  cv::Mat3b texture;
  cv::Vec3b colour{200, 200, 200};
};

cv::Mat3b decode(const void* bytes, size_t size) {
  const cv::Mat data(1, static_cast<int>(size), CV_8UC1, const_cast<void*>(bytes));
  return cv::imdecode(data, cv::IMREAD_COLOR);
}

cv::Mat3b embedded_image(const aiTexture& texture) {
  if (texture.mHeight == 0) return decode(texture.pcData, texture.mWidth);
  cv::Mat3b image(static_cast<int>(texture.mHeight), static_cast<int>(texture.mWidth));
  for (int y = 0; y < image.rows; ++y) {
    for (int x = 0; x < image.cols; ++x) {
      const aiTexel& texel = texture.pcData[static_cast<size_t>(y) * texture.mWidth + static_cast<size_t>(x)];
      image(y, x) = {texel.b, texel.g, texel.r};
    }
  }
  return image;
}

// Files name their images with either kind of slash, often with a folder of the machine that wrote them.
cv::Mat3b image_beside(const fs::path& model, std::string name) {
  std::replace(name.begin(), name.end(), '\\', '/');
  for (const fs::path& candidate : {model.parent_path() / name, model.parent_path() / fs::path(name).filename()}) {
    std::error_code ignored;
    if (!fs::is_regular_file(candidate, ignored)) continue;
    const std::string bytes = read_file(candidate);
    cv::Mat3b image = decode(bytes.data(), bytes.size());
    if (!image.empty()) return image;
  }
  return {};
}

uint8_t level_of(double value) { return static_cast<uint8_t>(std::lround(std::clamp(value, 0.0, 1.0) * 255)); }

Look look_of(const aiScene& scene, const aiMaterial& material, const fs::path& path, bool linear_colours) {
  Look look;
  bool has_colour = false;
  aiColor4D colour(1, 1, 1, 1);
  if (material.Get(AI_MATKEY_BASE_COLOR, colour) == AI_SUCCESS ||
      material.Get(AI_MATKEY_COLOR_DIFFUSE, colour) == AI_SUCCESS) {
    has_colour = true;
    const double rgb[] = {colour.r, colour.g, colour.b};
    for (int i = 0; i < 3; ++i) look.colour[2 - i] = level_of(linear_colours ? srgb_of(rgb[i]) : rgb[i]);
  }
  aiString name;
  if (material.GetTexture(aiTextureType_BASE_COLOR, 0, &name) != AI_SUCCESS &&
      material.GetTexture(aiTextureType_DIFFUSE, 0, &name) != AI_SUCCESS) {
    return look;
  }
  const aiTexture* embedded = scene.GetEmbeddedTexture(name.C_Str());
  look.texture = embedded ? embedded_image(*embedded) : image_beside(path, name.C_Str());
  if (look.texture.empty()) {
    spdlog::warn("{}: the texture '{}' is missing or cannot be read; its colour is used instead", path.string(),
                 name.C_Str());
  } else if (has_colour && look.colour != cv::Vec3b(255, 255, 255) && look.colour != cv::Vec3b(0, 0, 0)) {
    cv::multiply(look.texture, cv::Scalar(look.colour[0] / 255.0, look.colour[1] / 255.0, look.colour[2] / 255.0),
                 look.texture);
  }
  return look;
}

TriangleMesh mesh_of(const aiMesh& mesh, const Eigen::Matrix4d& file_from_node, const Look& look, bool linear_colours) {
  TriangleMesh result{.texture = look.texture, .colour = look.colour};
  for (unsigned i = 0; i < mesh.mNumVertices; ++i) {
    const aiVector3D& v = mesh.mVertices[i];
    result.vertices.push_back((file_from_node * Eigen::Vector4d(v.x, v.y, v.z, 1)).head<3>().cast<float>());
  }
  if (!result.texture.empty() && mesh.HasTextureCoords(0)) {
    for (unsigned i = 0; i < mesh.mNumVertices; ++i) {
      const aiVector3D& uv = mesh.mTextureCoords[0][i];
      result.texture_coordinates.emplace_back(uv.x, uv.y);
    }
  } else {
    result.texture = cv::Mat3b();
  }
  if (result.texture.empty() && mesh.HasVertexColors(0) && mesh.mNumVertices > 0) {
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();
    for (unsigned i = 0; i < mesh.mNumVertices; ++i) {
      const aiColor4D& c = mesh.mColors[0][i];
      sum += Eigen::Vector3d(c.b, c.g, c.r);
      const auto level = [&](double value) { return level_of(linear_colours ? srgb_of(value) : value); };
      result.vertex_colours.emplace_back(level(c.b), level(c.g), level(c.r));
    }
    for (int i = 0; i < 3; ++i) result.colour[i] = level_of(sum[i] / mesh.mNumVertices);
  }
  // A mirroring transform turns the triangles inside out.
  const bool mirrored = file_from_node.topLeftCorner<3, 3>().determinant() < 0;
  for (unsigned i = 0; i < mesh.mNumFaces; ++i) {
    const aiFace& face = mesh.mFaces[i];
    if (face.mNumIndices != 3) continue;  // points and lines
    Eigen::Vector3i triangle(static_cast<int>(face.mIndices[0]), static_cast<int>(face.mIndices[1]),
                             static_cast<int>(face.mIndices[2]));
    if (mirrored) std::swap(triangle[1], triangle[2]);
    result.triangles.push_back(triangle);
  }
  return result;
}

void collect(const aiScene& scene, const aiNode& node, const Eigen::Matrix4d& file_from_parent,
             const std::vector<Look>& looks, bool linear_colours, std::vector<TriangleMesh>& meshes) {
  const Eigen::Matrix4d file_from_node = file_from_parent * matrix_of(node.mTransformation);
  for (unsigned i = 0; i < node.mNumMeshes; ++i) {
    const aiMesh& mesh = *scene.mMeshes[node.mMeshes[i]];
    TriangleMesh result = mesh_of(mesh, file_from_node, looks.at(mesh.mMaterialIndex), linear_colours);
    if (result.triangles.empty()) continue;
    result.name = node.mName.length > 0 ? node.mName.C_Str() : mesh.mName.C_Str();
    meshes.push_back(std::move(result));
  }
  for (unsigned i = 0; i < node.mNumChildren; ++i)
    collect(scene, *node.mChildren[i], file_from_node, looks, linear_colours, meshes);
}

}  // namespace

std::vector<TriangleMesh> read_meshes(const fs::path& path) {
  std::error_code ignored;
  if (!fs::is_regular_file(path, ignored)) {
    throw InputError(path, "is no file", "name a model: .obj, .ply, .stl, .gltf, .glb, .dae, .fbx, .3mf …");
  }
  Assimp::Importer importer;
  // Texture coordinates from the upper-left corner, as TriangleMesh has them.
  const aiScene* scene =
      importer.ReadFile(path.string(), aiProcess_Triangulate | aiProcess_JoinIdenticalVertices | aiProcess_FlipUVs);
  if (!scene || !scene->mRootNode) {
    throw InputError(path, std::string("cannot be read as a model (") + importer.GetErrorString() + ")",
                     "convert it to .glb, .obj or .ply");
  }
  std::string ending = path.extension().string();
  std::transform(ending.begin(), ending.end(), ending.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  const bool is_gltf = ending == ".glb" || ending == ".gltf";
  std::vector<Look> looks;
  for (unsigned i = 0; i < scene->mNumMaterials; ++i)
    looks.push_back(look_of(*scene, *scene->mMaterials[i], path, is_gltf));
  std::vector<TriangleMesh> meshes;
  Eigen::Matrix4d world_from_file = Eigen::Matrix4d::Identity();
  if (is_gltf) world_from_file.topLeftCorner<3, 3>() << 1, 0, 0, 0, 0, -1, 0, 1, 0;  // y up -> z up
  collect(*scene, *scene->mRootNode, world_from_file, looks, is_gltf, meshes);
  if (meshes.empty())
    throw InputError(path, "has no triangle", "export the model with its faces; points and lines are not enough");
  for (const TriangleMesh& mesh : meshes) {
    for (const Eigen::Vector3f& vertex : mesh.vertices) {
      if (!vertex.allFinite()) throw InputError(path, "has a vertex that is no number", "export the model again");
    }
    for (const Eigen::Vector2f& coordinates : mesh.texture_coordinates) {
      if (!coordinates.allFinite()) {
        throw InputError(path, "has texture coordinates that are no numbers", "export the model again");
      }
    }
  }
  return meshes;
}

namespace {

tinygltf::Model model_of(const std::vector<TriangleMesh>& meshes, const GlbOptions& options) {
  ModelBuilder builder;
  const int world = builder.add_world();
  const std::array<float, 256> levels = linear_levels();
  std::map<const void*, int> materials_of_textures;
  std::map<std::array<uint8_t, 3>, int> materials_of_colours;
  for (const TriangleMesh& mesh : meshes) {
    if (mesh.triangles.empty()) continue;
    std::vector<uint32_t> indices;
    for (const Eigen::Vector3i& triangle : mesh.triangles) {
      for (int i = 0; i < 3; ++i) {
        IRIS_CHECK(triangle[i] >= 0 && triangle[i] < static_cast<int>(mesh.vertices.size()));
        indices.push_back(static_cast<uint32_t>(triangle[i]));
      }
    }
    const bool textured = !mesh.texture.empty() && !mesh.texture_coordinates.empty();
    int material = 0;
    if (textured) {
      IRIS_CHECK(mesh.texture_coordinates.size() == mesh.vertices.size());
      const auto [found, added] = materials_of_textures.try_emplace(mesh.texture.data, 0);
      if (added) {
        std::vector<unsigned char> bytes;
        const bool jpeg = options.jpeg_quality > 0;
        IRIS_CHECK(jpeg ? cv::imencode(".jpg", mesh.texture, bytes, {cv::IMWRITE_JPEG_QUALITY, options.jpeg_quality})
                        : cv::imencode(".png", mesh.texture, bytes));
        const int texture = builder.add_texture(bytes, jpeg ? "image/jpeg" : "image/png");
        found->second = builder.add_unlit_material("texture " + std::to_string(texture), {1, 1, 1});
        builder.model().materials.back().pbrMetallicRoughness.baseColorTexture.index = texture;
        builder.model().materials.back().doubleSided = true;
      }
      material = found->second;
    } else {
      // Colours of vertices are multiplied by the material's.
      const cv::Vec3b c = mesh.vertex_colours.empty() ? mesh.colour : cv::Vec3b(255, 255, 255);
      const auto [found, added] = materials_of_colours.try_emplace({c[2], c[1], c[0]}, 0);
      if (added) {
        found->second = builder.add_unlit_material("colour " + std::to_string(materials_of_colours.size()),
                                                   {levels[c[2]], levels[c[1]], levels[c[0]]});
        builder.model().materials.back().doubleSided = true;
      }
      material = found->second;
    }
    tinygltf::Primitive surface = primitive(TINYGLTF_MODE_TRIANGLES, material, builder.add_positions(mesh.vertices));
    if (textured) surface.attributes["TEXCOORD_0"] = builder.add_texture_coordinates(mesh.texture_coordinates);
    if (!textured && !mesh.vertex_colours.empty()) {
      IRIS_CHECK(mesh.vertex_colours.size() == mesh.vertices.size());
      std::vector<std::array<uint16_t, 4>> colours;
      for (const cv::Vec3b& c : mesh.vertex_colours) {
        colours.push_back({linear_16(levels[c[2]]), linear_16(levels[c[1]]), linear_16(levels[c[0]]), 65535});
      }
      surface.attributes["COLOR_0"] = builder.add_colours(colours);
    }
    surface.indices = builder.add_indices(indices);
    builder.add_mesh_node(world, mesh.name, surface);
  }
  tinygltf::Model model = std::move(builder.model());
  if (model.buffers[0].data.empty()) model.buffers.clear();
  model.asset.version = "2.0";
  model.asset.generator = "IRIS " IRIS_VERSION;
  return model;
}

}  // namespace

std::string encode_glb(const std::vector<TriangleMesh>& meshes, const GlbOptions& options) {
  tinygltf::Model model = model_of(meshes, options);
  std::ostringstream stream;
  IRIS_CHECK(tinygltf::TinyGLTF().WriteGltfSceneToStream(&model, stream, false, true));
  return stream.str();
}

void write_glb(const fs::path& path, const std::vector<TriangleMesh>& meshes, const GlbOptions& options) {
  write_file(path, encode_glb(meshes, options));
}

namespace {

// What assimp exports; it frees what the scene points to.
std::unique_ptr<aiScene> assimp_scene(const TriangleMesh& mesh, bool with_colours) {
  auto scene = std::make_unique<aiScene>();
  // Below a node of its own: the writer of 3MF looks for no other.
  scene->mRootNode = new aiNode("world");
  auto* node = new aiNode(mesh.name);
  scene->mRootNode->addChildren(1, &node);
  scene->mNumMaterials = 1;
  scene->mMaterials = new aiMaterial* [1] { new aiMaterial };
  const aiColor3D white(1, 1, 1);
  scene->mMaterials[0]->AddProperty(&white, 1, AI_MATKEY_COLOR_DIFFUSE);
  auto* part = new aiMesh;
  scene->mNumMeshes = 1;
  scene->mMeshes = new aiMesh* [1] { part };
  node->mNumMeshes = 1;
  node->mMeshes = new unsigned[1]{0};
  part->mName = mesh.name;
  part->mPrimitiveTypes = aiPrimitiveType_TRIANGLE;
  part->mNumVertices = static_cast<unsigned>(mesh.vertices.size());
  part->mVertices = new aiVector3D[part->mNumVertices];
  // Several of assimp's writers ask for normals.
  std::vector<Eigen::Vector3f> normals(mesh.vertices.size(), Eigen::Vector3f::Zero());
  for (const Eigen::Vector3i& t : mesh.triangles) {
    const auto corner = [&](int i) { return mesh.vertices[static_cast<size_t>(t[i])]; };
    const Eigen::Vector3f normal = (corner(1) - corner(0)).cross(corner(2) - corner(0));
    for (int i = 0; i < 3; ++i) normals[static_cast<size_t>(t[i])] += normal;
  }
  part->mNormals = new aiVector3D[part->mNumVertices];
  if (with_colours) part->mColors[0] = new aiColor4D[part->mNumVertices];
  for (unsigned i = 0; i < part->mNumVertices; ++i) {
    const Eigen::Vector3f &v = mesh.vertices[i], n = normals[i].normalized();
    part->mVertices[i] = {v.x(), v.y(), v.z()};
    part->mNormals[i] = {n.x(), n.y(), n.z()};
    if (!with_colours) continue;
    const cv::Vec3b& c = mesh.vertex_colours[i];
    part->mColors[0][i] = {static_cast<float>(c[2]) / 255, static_cast<float>(c[1]) / 255,
                           static_cast<float>(c[0]) / 255, 1};
  }
  part->mNumFaces = static_cast<unsigned>(mesh.triangles.size());
  part->mFaces = new aiFace[part->mNumFaces];
  for (unsigned i = 0; i < part->mNumFaces; ++i) {
    part->mFaces[i].mNumIndices = 3;
    part->mFaces[i].mIndices = new unsigned[3];
    for (int k = 0; k < 3; ++k) part->mFaces[i].mIndices[k] = static_cast<unsigned>(mesh.triangles[i][k]);
  }
  return scene;
}

// assimp's own binary PLY with colours cannot be read back by its reader.
std::string encode_ply(const TriangleMesh& mesh) {
  const bool coloured = !mesh.vertex_colours.empty();
  std::string bytes =
      "ply\nformat binary_little_endian 1.0\ncomment IRIS " IRIS_VERSION ", metres, z up\nelement vertex " +
      std::to_string(mesh.vertices.size()) + "\nproperty float x\nproperty float y\nproperty float z\n" +
      (coloured ? "property uchar red\nproperty uchar green\nproperty uchar blue\n" : "") + "element face " +
      std::to_string(mesh.triangles.size()) + "\nproperty list uchar int vertex_indices\nend_header\n";
  for (size_t i = 0; i < mesh.vertices.size(); ++i) {
    bytes.append(reinterpret_cast<const char*>(mesh.vertices[i].data()), 3 * sizeof(float));
    if (!coloured) continue;
    const cv::Vec3b& bgr = mesh.vertex_colours[i];
    for (int k = 2; k >= 0; --k) bytes.push_back(static_cast<char>(bgr[k]));
  }
  for (const Eigen::Vector3i& triangle : mesh.triangles) {
    bytes.push_back(3);
    bytes.append(reinterpret_cast<const char*>(triangle.data()), 3 * sizeof(int));
  }
  return bytes;
}

}  // namespace

void write_mesh(const fs::path& path, const TriangleMesh& mesh) {
  IRIS_CHECK(mesh.vertex_colours.empty() || mesh.vertex_colours.size() == mesh.vertices.size());
  const std::string format = path.extension().string();
  if (format == ".glb") {
    write_glb(path, {mesh});
    return;
  }
  if (format == ".ply") {
    write_file(path, encode_ply(mesh));
    return;
  }
  // Name in assimp, and whether vertex colours are written.
  static const std::map<std::string, std::pair<const char*, bool>> kWriters = {
      {".obj", {"objnomtl", true}}, {".stl", {"stlb", false}}, {".fbx", {"fbxa", true}},
      {".3mf", {"3mf", false}},     {".x3d", {"x3d", true}},   {".dae", {"collada", true}}};
  const auto writer = kWriters.find(format);
  if (writer == kWriters.end()) {
    throw UsageError(path.string() + ": surfaces are written as .ply, .obj, .stl, .fbx, .3mf, .x3d, .dae or .glb");
  }
  const auto& [name, has_colours] = writer->second;
  const auto scene = assimp_scene(mesh, has_colours && !mesh.vertex_colours.empty());
  write_file_with(path, [&, name = name](const fs::path& temporary) {
    Assimp::Exporter exporter;
    if (exporter.Export(scene.get(), name, temporary.string()) != AI_SUCCESS) {
      throw InputError(path, std::string("cannot be written (") + exporter.GetErrorString() + ")",
                       "check the folder, its permissions and the free space");
    }
  });
}

}  // namespace iris::exporters
