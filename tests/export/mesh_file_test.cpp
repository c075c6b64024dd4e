#include "export/mesh_file.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <tiny_gltf.h>

#include <Eigen/Geometry>
#include <cmath>
#include <cstdlib>
#include <limits>
#include <opencv2/imgcodecs.hpp>

#include "iris/core/atomic_file.h"
#include "iris/core/error.h"
#include "support/temporary_folder.h"

namespace iris::exporters {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

class MeshFile : public ::testing::Test {
 protected:
  testing::TemporaryFolder temporary_;
  const fs::path folder_ = temporary_.path();

  fs::path file(const std::string& name, const std::string& content) const {
    write_file(folder_ / name, content);
    return folder_ / name;
  }
};

cv::Mat3b pattern() {
  cv::Mat3b image(16, 32);
  for (int y = 0; y < image.rows; ++y) {
    for (int x = 0; x < image.cols; ++x)
      image(y, x) = cv::Vec3b(static_cast<uint8_t>(8 * x), static_cast<uint8_t>(16 * y), 77);
  }
  return image;
}

// A rectangle with a texture, and a triangle with a colour.
std::vector<TriangleMesh> two_meshes() {
  return {{.name = "wall",
           .vertices = {{0, 1, 2}, {4, 1, 2}, {4, 1, 5}, {0, 1, 5}},
           .triangles = {{0, 1, 2}, {0, 2, 3}},
           .texture_coordinates = {{0, 3}, {2, 3}, {2, 0}, {0, 0}},
           .texture = pattern()},
          {.name = "roof",
           .vertices = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0.5f}},
           .triangles = {{0, 1, 2}},
           .colour = {10, 128, 250}}};
}

Eigen::AlignedBox3f box_of(const TriangleMesh& mesh) {
  Eigen::AlignedBox3f box;
  for (const Eigen::Vector3f& v : mesh.vertices) box.extend(v);
  return box;
}

TEST_F(MeshFile, GlbComesBackThroughAForeignReader) {
  const std::vector<TriangleMesh> meshes = two_meshes();
  write_glb(folder_ / "a.glb", meshes, {.jpeg_quality = 0});
  const std::vector<TriangleMesh> read = read_meshes(folder_ / "a.glb");
  ASSERT_EQ(read.size(), 2u);
  for (size_t i = 0; i < 2; ++i) {
    EXPECT_EQ(read[i].name, meshes[i].name);
    ASSERT_EQ(read[i].vertices.size(), meshes[i].vertices.size());
    ASSERT_EQ(read[i].triangles.size(), meshes[i].triangles.size());
    // The same corners in the same order, whatever their indices.
    for (size_t t = 0; t < meshes[i].triangles.size(); ++t) {
      for (int c = 0; c < 3; ++c) {
        const size_t a = static_cast<size_t>(meshes[i].triangles[t][c]),
                     b = static_cast<size_t>(read[i].triangles[t][c]);
        EXPECT_LT((read[i].vertices[b] - meshes[i].vertices[a]).norm(), 1e-6f);
        if (i == 0) {
          EXPECT_LT((read[i].texture_coordinates[b] - meshes[i].texture_coordinates[a]).norm(), 1e-6f);
        }
      }
    }
  }
  ASSERT_EQ(read[0].texture.size(), meshes[0].texture.size());
  EXPECT_EQ(cv::norm(read[0].texture, meshes[0].texture, cv::NORM_INF), 0);
  EXPECT_TRUE(read[1].texture.empty());
  EXPECT_TRUE(read[1].texture_coordinates.empty());
  for (int i = 0; i < 3; ++i) EXPECT_NEAR(read[1].colour[i], meshes[1].colour[i], 1);
}

TEST_F(MeshFile, GlbSharesTexturesAndNamesItsNodes) {
  std::vector<TriangleMesh> meshes = two_meshes();
  meshes.push_back(meshes[0]);  // the same image
  meshes.back().name = "other wall";
  meshes.push_back({.name = "nothing"});
  const std::string bytes = encode_glb(meshes);
  EXPECT_EQ(bytes, encode_glb(meshes));
  tinygltf::Model model;
  std::string error, warning;
  ASSERT_TRUE(tinygltf::TinyGLTF().LoadBinaryFromMemory(&model, &error, &warning,
                                                        reinterpret_cast<const unsigned char*>(bytes.data()),
                                                        static_cast<unsigned>(bytes.size())))
      << error;
  EXPECT_EQ(model.images.size(), 1u);
  ASSERT_EQ(model.nodes.size(), 4u);
  EXPECT_EQ(model.nodes[0].name, "world");
  EXPECT_EQ(model.nodes[3].name, "other wall");
  EXPECT_EQ(model.meshes[2].primitives[0].material, model.meshes[0].primitives[0].material);
  EXPECT_EQ(model.samplers.at(0).wrapS, TINYGLTF_TEXTURE_WRAP_REPEAT);
  EXPECT_EQ(model.extensionsUsed, std::vector<std::string>{"KHR_materials_unlit"});
  meshes[0].vertices[0].x() += 0.001f;
  EXPECT_NE(bytes, encode_glb(meshes));
}

TEST_F(MeshFile, ReadsObjWithItsMaterialsAndImages) {
  cv::imwrite((folder_ / "bricks.png").string(), pattern());
  file("house.mtl",
       "newmtl bricks\nKd 1 1 1\nmap_Kd C:\\models\\bricks.png\nnewmtl paint\nKd 0.2 0.4 0.6\nnewmtl lost\nKd 1 0 "
       "0\nmap_Kd lost.png\n");
  const fs::path path = file(
      "house.obj",
      "mtllib house.mtl\nv 0 0 0\nv 2 0 0\nv 2 0 3\nv 0 0 3\nv 1 1 1\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
      "o wall\nusemtl bricks\nf 1/1 2/2 3/3 4/4\no roof\nusemtl paint\nf 1 2 5\no door\nusemtl lost\nf 1/1 2/2 5/3\n");
  const std::vector<TriangleMesh> meshes = read_meshes(path);
  ASSERT_EQ(meshes.size(), 3u);
  EXPECT_EQ(meshes[0].name, "wall");
  EXPECT_EQ(meshes[0].triangles.size(), 2u);  // the rectangle is cut
  ASSERT_EQ(meshes[0].texture.size(), pattern().size());
  EXPECT_EQ(cv::norm(meshes[0].texture, pattern(), cv::NORM_INF), 0);
  // OBJ's origin of texture coordinates is the lower left: (0, 0) there is (0, 1) here.
  for (size_t i = 0; i < meshes[0].vertices.size(); ++i) {
    EXPECT_NEAR(meshes[0].texture_coordinates[i].y(), 1 - meshes[0].vertices[i].z() / 3, 1e-6);
    EXPECT_NEAR(meshes[0].texture_coordinates[i].x(), meshes[0].vertices[i].x() / 2, 1e-6);
  }
  EXPECT_EQ(meshes[1].colour, cv::Vec3b(153, 102, 51));
  EXPECT_TRUE(meshes[2].texture.empty());
  EXPECT_EQ(meshes[2].colour, cv::Vec3b(0, 0, 255));
}

TEST_F(MeshFile, ReadsPlyAndStl) {
  const std::vector<TriangleMesh> ply =
      read_meshes(file("a.ply",
                       "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
                       "property uchar red\nproperty uchar green\nproperty uchar blue\nelement face 1\n"
                       "property list uchar int vertex_indices\nend_header\n0 0 0 255 0 102\n1 0 0 255 0 102\n1 1 0 "
                       "255 0 102\n0 1 0 255 0 102\n4 0 1 2 3\n"));
  ASSERT_EQ(ply.size(), 1u);
  EXPECT_EQ(ply[0].triangles.size(), 2u);
  EXPECT_EQ(ply[0].colour, cv::Vec3b(102, 0, 255));
  const std::vector<TriangleMesh> stl =
      read_meshes(file("a.stl",
                       "solid thing\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 2 0 0\nvertex 0 5 "
                       "0\nendloop\nendfacet\nendsolid thing\n"));
  ASSERT_EQ(stl.size(), 1u);
  EXPECT_EQ(stl[0].triangles.size(), 1u);
  EXPECT_EQ(box_of(stl[0]).max(), Eigen::Vector3f(2, 5, 0));
}

// A node that mirrors and moves: triangles stay counter-clockwise seen from outside.
TEST_F(MeshFile, AppliesTheTransformsOfNodes) {
  tinygltf::Model model;
  const std::string bytes = encode_glb({two_meshes()[1]});
  std::string error, warning;
  ASSERT_TRUE(tinygltf::TinyGLTF().LoadBinaryFromMemory(&model, &error, &warning,
                                                        reinterpret_cast<const unsigned char*>(bytes.data()),
                                                        static_cast<unsigned>(bytes.size())));
  model.nodes[0].rotation.clear();
  model.nodes[0].scale = {-2, 1, 1};
  model.nodes[1].translation = {10, 0, 0};
  ASSERT_TRUE(tinygltf::TinyGLTF().WriteGltfSceneToFile(&model, (folder_ / "m.glb").string(), true, true, false, true));
  const std::vector<TriangleMesh> meshes = read_meshes(folder_ / "m.glb");
  ASSERT_EQ(meshes.size(), 1u);
  EXPECT_NEAR(box_of(meshes[0]).max().x(), -20, 1e-5);
  EXPECT_NEAR(box_of(meshes[0]).min().x(), -22, 1e-5);
  const auto corner = [&](int i) { return meshes[0].vertices[static_cast<size_t>(meshes[0].triangles[0][i])]; };
  EXPECT_LT((corner(1) - corner(0)).cross(corner(2) - corner(0)).y(), 0);  // glTF's +z is -y of a z-up world
}

TEST_F(MeshFile, SaysWhatIsWrongWithAFile) {
  const auto message = [](const fs::path& path) -> std::string {
    try {
      read_meshes(path);
    } catch (const InputError& error) {
      return error.what();
    }
    return "no error";
  };
  EXPECT_THAT(message(folder_ / "missing.obj"), HasSubstr("missing.obj: is no file"));
  EXPECT_THAT(message(folder_), HasSubstr("is no file"));
  EXPECT_THAT(message(file("text.txt", "hello")), HasSubstr("text.txt: cannot be read as a model"));
  EXPECT_THAT(message(file("broken.glb", "glTF but not really")), HasSubstr("broken.glb: cannot be read as a model"));
  const fs::path points = file("points.ply",
                               "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty "
                               "float z\nend_header\n0 0 0\n1 1 1\n");
  EXPECT_THAT(message(points), HasSubstr("points.ply"));
  EXPECT_THROW(write_glb(folder_ / "text.txt" / "a.glb", two_meshes()), InputError);
}

// Each format is read back by assimp: the same number of triangles, the same box, colours where the format has them.
TEST_F(MeshFile, SurfacesInEveryFormatAreReadBack) {
  TriangleMesh ridge{.name = "surface"};
  constexpr int kSide = 12;
  for (int y = 0; y < kSide; ++y) {
    for (int x = 0; x < kSide; ++x) {
      ridge.vertices.emplace_back(0.25f * static_cast<float>(x), 0.5f * static_cast<float>(y),
                                  std::abs(static_cast<float>(x - 5)) * 0.125f);
      ridge.vertex_colours.push_back({static_cast<uint8_t>(20 * x), static_cast<uint8_t>(20 * y), 90});
      if (x == 0 || y == 0) continue;
      const int i = y * kSide + x;
      ridge.triangles.emplace_back(i - kSide - 1, i - kSide, i);
      ridge.triangles.emplace_back(i - kSide - 1, i, i - 1);
    }
  }
  for (const std::string format : {"ply", "obj", "stl", "fbx", "3mf", "x3d", "dae", "glb"}) {
    SCOPED_TRACE(format);
    const fs::path path = folder_ / ("mesh." + format);
    write_mesh(path, ridge);
    const std::vector<TriangleMesh> back = read_meshes(path);
    ASSERT_EQ(back.size(), 1u);
    EXPECT_EQ(back[0].triangles.size(), ridge.triangles.size());
    const Eigen::AlignedBox3f box = box_of(back[0]);
    EXPECT_LT((box.sizes() - box_of(ridge).sizes()).norm(), 1e-4);
    double up = 0;
    for (const Eigen::Vector3i& t : back[0].triangles) {
      const auto corner = [&](int i) { return back[0].vertices[static_cast<size_t>(t[i])]; };
      up += (corner(1) - corner(0)).cross(corner(2) - corner(0)).z();
    }
    EXPECT_GT(up, 0);
    if (format == "stl" || format == "3mf") continue;
    ASSERT_EQ(back[0].vertex_colours.size(), back[0].vertices.size());
    for (size_t i = 0; i < back[0].vertices.size(); ++i) {
      const Eigen::Vector3f& v = back[0].vertices[i];
      const cv::Vec3b expected(static_cast<uint8_t>(std::lround(v.x() * 80)),
                               static_cast<uint8_t>(std::lround(v.y() * 40)), 90);
      for (int k = 0; k < 3; ++k) EXPECT_NEAR(back[0].vertex_colours[i][k], expected[k], 1);
    }
  }
  EXPECT_THROW(write_mesh(folder_ / "mesh.xyz", ridge), UsageError);
  file("plain", "");
  EXPECT_THROW(write_mesh(folder_ / "plain" / "mesh.ply", ridge), InputError);
}

// Khronos' own validator as the foreign reader.
TEST_F(MeshFile, PassesTheGltfValidator) {
  const fs::path tools = fs::path(IRIS_SOURCE_DIR) / "tests/tools";
  if (std::system("node --version >/dev/null 2>&1") != 0 || !fs::exists(tools / "node_modules/gltf-validator")) {
    GTEST_SKIP() << "skipped: no node or no gltf-validator (npm --prefix " << tools.string() << " install)";
  }
  const auto problems = [&](const std::vector<TriangleMesh>& meshes, int quality) {
    const fs::path glb = folder_ / "v.glb";
    write_glb(glb, meshes, {.jpeg_quality = quality});
    const std::string log = (folder_ / "log.txt").string();
    const int status = std::system(
        ("node '" + (tools / "check_gltf.mjs").string() + "' '" + glb.string() + "' >'" + log + "' 2>&1").c_str());
    return status == 0 ? "" : read_file(log);
  };
  EXPECT_EQ(problems(two_meshes(), 90), "");
  EXPECT_EQ(problems(two_meshes(), 0), "");
  EXPECT_EQ(problems({two_meshes()[1]}, 90), "");
  EXPECT_EQ(problems({}, 90), "");
}

TEST_F(MeshFile, TextureCoordinatesThatAreNoNumbersAreRefused) {
  TriangleMesh mesh{.texture = pattern()};
  mesh.vertices = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}};
  mesh.triangles = {{0, 1, 2}};
  mesh.texture_coordinates = {{0, 0}, {1, 0}, {0, 1}};
  write_glb(folder_ / "good.glb", {mesh});
  EXPECT_EQ(read_meshes(folder_ / "good.glb").size(), 1u);
  mesh.texture_coordinates[1].x() = std::numeric_limits<float>::quiet_NaN();
  write_glb(folder_ / "nan.glb", {mesh});
  EXPECT_THROW(read_meshes(folder_ / "nan.glb"), InputError);
}

}  // namespace
}  // namespace iris::exporters
