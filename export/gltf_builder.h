// What the glTF writers share.
#pragma once

#include <tiny_gltf.h>

#include <Eigen/Geometry>
#include <array>
#include <bit>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <string>
#include <vector>

#include "export/colours.h"

namespace iris::exporters {

static_assert(std::endian::native == std::endian::little, "glTF stores little-endian numbers");

// Appends arrays to the one buffer of the model.
class ModelBuilder {
 public:
  ModelBuilder() { model_.buffers.emplace_back(); }

  int add_positions(const std::vector<Eigen::Vector3f>& positions) {
    Eigen::AlignedBox3f box;
    for (const Eigen::Vector3f& p : positions) box.extend(p);
    const int accessor = add_array(positions.data(), positions.size(), sizeof(Eigen::Vector3f),
                                   TINYGLTF_TARGET_ARRAY_BUFFER, TINYGLTF_COMPONENT_TYPE_FLOAT, TINYGLTF_TYPE_VEC3);
    model_.accessors.back().minValues.assign(box.min().data(), box.min().data() + 3);
    model_.accessors.back().maxValues.assign(box.max().data(), box.max().data() + 3);
    return accessor;
  }

  // Four components, so that each colour begins at a multiple of four bytes.
  int add_colours(const std::vector<std::array<uint16_t, 4>>& colours) {
    const int accessor = add_array(colours.data(), colours.size(), sizeof(colours[0]), TINYGLTF_TARGET_ARRAY_BUFFER,
                                   TINYGLTF_COMPONENT_TYPE_UNSIGNED_SHORT, TINYGLTF_TYPE_VEC4);
    model_.accessors.back().normalized = true;
    return accessor;
  }

  int add_indices(const std::vector<uint32_t>& indices) {
    return add_array(indices.data(), indices.size(), sizeof(uint32_t), TINYGLTF_TARGET_ELEMENT_ARRAY_BUFFER,
                     TINYGLTF_COMPONENT_TYPE_UNSIGNED_INT, TINYGLTF_TYPE_SCALAR);
  }

  // A colour of its own, whatever the light; `rgb` is linear.
  int add_unlit_material(const std::string& name, const std::array<double, 3>& rgb) {
    tinygltf::Material material;
    material.name = name;
    material.pbrMetallicRoughness.baseColorFactor = {rgb[0], rgb[1], rgb[2], 1};
    material.pbrMetallicRoughness.metallicFactor = 0;  // for viewers that do not know the extension
    material.extensions["KHR_materials_unlit"] = tinygltf::Value(tinygltf::Value::Object());
    model_.extensionsUsed = {"KHR_materials_unlit"};
    model_.materials.push_back(material);
    return static_cast<int>(model_.materials.size()) - 1;
  }

  // Node with a mesh of one primitive, below `parent`.
  int add_mesh_node(int parent, const std::string& name, const tinygltf::Primitive& primitive) {
    tinygltf::Mesh mesh;
    mesh.name = name;
    mesh.primitives = {primitive};
    model_.meshes.push_back(mesh);
    const int node = add_node(parent, name);
    model_.nodes[static_cast<size_t>(node)].mesh = static_cast<int>(model_.meshes.size()) - 1;
    return node;
  }

  // parent = -1: the top of the scene.
  int add_node(int parent, const std::string& name) {
    const int index = static_cast<int>(model_.nodes.size());
    model_.nodes.emplace_back();
    model_.nodes.back().name = name;
    if (parent >= 0) {
      model_.nodes[static_cast<size_t>(parent)].children.push_back(index);
    } else {
      tinygltf::Scene scene;
      scene.name = name;
      scene.nodes = {index};
      model_.scenes.push_back(scene);
      model_.defaultScene = 0;
    }
    return index;
  }

  // The top of a scene whose z points up: turns it to glTF's y up.
  int add_world() {
    const int world = add_node(-1, "world");
    // -90 degrees about x. Order x, y, z, w.
    model_.nodes[static_cast<size_t>(world)].rotation = {-std::sqrt(0.5), 0, 0, std::sqrt(0.5)};
    return world;
  }

  int add_texture_coordinates(const std::vector<Eigen::Vector2f>& coordinates) {
    return add_array(coordinates.data(), coordinates.size(), sizeof(Eigen::Vector2f), TINYGLTF_TARGET_ARRAY_BUFFER,
                     TINYGLTF_COMPONENT_TYPE_FLOAT, TINYGLTF_TYPE_VEC2);
  }

  // Of an animation: ascending moments [s], and what is there then.
  int add_times(const std::vector<float>& times) {
    const int accessor =
        add_array(times.data(), times.size(), sizeof(float), 0, TINYGLTF_COMPONENT_TYPE_FLOAT, TINYGLTF_TYPE_SCALAR);
    model_.accessors.back().minValues = {times.front()};
    model_.accessors.back().maxValues = {times.back()};
    return accessor;
  }
  int add_vectors(const std::vector<Eigen::Vector3f>& vectors) {
    return add_array(vectors.data(), vectors.size(), sizeof(vectors[0]), 0, TINYGLTF_COMPONENT_TYPE_FLOAT,
                     TINYGLTF_TYPE_VEC3);
  }
  int add_vectors(const std::vector<Eigen::Vector4f>& vectors) {
    return add_array(vectors.data(), vectors.size(), sizeof(vectors[0]), 0, TINYGLTF_COMPONENT_TYPE_FLOAT,
                     TINYGLTF_TYPE_VEC4);
  }

  // A repeating texture from an encoded image.
  int add_texture(const std::vector<unsigned char>& bytes, const std::string& mime_type) {
    std::vector<unsigned char>& buffer = model_.buffers[0].data;
    tinygltf::BufferView view;
    view.buffer = 0;
    view.byteOffset = buffer.size();
    view.byteLength = bytes.size();
    model_.bufferViews.push_back(view);
    buffer.insert(buffer.end(), bytes.begin(), bytes.end());
    buffer.resize((buffer.size() + 3) / 4 * 4);  // arrays begin at multiples of four
    tinygltf::Image image;
    image.bufferView = static_cast<int>(model_.bufferViews.size()) - 1;
    image.mimeType = mime_type;
    model_.images.push_back(image);
    if (model_.samplers.empty()) {
      tinygltf::Sampler sampler;
      sampler.magFilter = TINYGLTF_TEXTURE_FILTER_LINEAR;
      sampler.minFilter = TINYGLTF_TEXTURE_FILTER_LINEAR_MIPMAP_LINEAR;
      sampler.wrapS = sampler.wrapT = TINYGLTF_TEXTURE_WRAP_REPEAT;
      model_.samplers.push_back(sampler);
    }
    tinygltf::Texture texture;
    texture.source = static_cast<int>(model_.images.size()) - 1;
    texture.sampler = 0;
    model_.textures.push_back(texture);
    return static_cast<int>(model_.textures.size()) - 1;
  }

  tinygltf::Model& model() { return model_; }

 private:
  int add_array(const void* data, size_t count, size_t stride, int target, int component_type, int type) {
    std::vector<unsigned char>& bytes = model_.buffers[0].data;
    tinygltf::BufferView view;
    view.buffer = 0;
    view.byteOffset = bytes.size();
    view.byteLength = count * stride;
    view.target = target;
    model_.bufferViews.push_back(view);
    bytes.resize(bytes.size() + count * stride);
    std::memcpy(bytes.data() + view.byteOffset, data, count * stride);
    tinygltf::Accessor accessor;
    accessor.bufferView = static_cast<int>(model_.bufferViews.size()) - 1;
    accessor.componentType = component_type;
    accessor.type = type;
    accessor.count = count;
    model_.accessors.push_back(accessor);
    return static_cast<int>(model_.accessors.size()) - 1;
  }

  tinygltf::Model model_;
};

inline tinygltf::Primitive primitive(int mode, int material, int positions) {
  tinygltf::Primitive primitive;
  primitive.mode = mode;
  primitive.material = material;
  primitive.attributes["POSITION"] = positions;
  return primitive;
}

// The bytes of a binary glTF file, written whole or not at all. Throws InputError.
void write_glb(const std::filesystem::path& glb, const tinygltf::Model& model);

}  // namespace iris::exporters
