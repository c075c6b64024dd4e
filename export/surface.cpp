#include "export/surface.h"

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <numeric>
#include <unordered_map>

#include "iris/core/error.h"
#include "iris/core/options.h"
#include "iris/core/parallel.h"

namespace iris::exporters {

void MeshOptions::declare(OptionSet& set) {
  set.section("mesh");
  set.add("formats", formats, {},
          "files of the surface, OUT/model/mesh.*, separated by commas: ply, obj, stl, fbx, 3mf, x3d, dae, glb");
  set.add("cell", cell, "m", 0.001, 10,
          "detail of the surface; below the distance of the cloud's points it becomes rough and full of holes");
  set.add("max_triangles", max_triangles, "", 1000, 50'000'000,
          "at most so many triangles; with more, mesh.cell is doubled until they fit");
  set.add("min_part", min_part, "", 0, 1'000'000, "separate pieces of fewer triangles are dropped");
}

std::vector<std::string> mesh_formats(const MeshOptions& options) {
  static const std::vector<std::string> kKnown = {"ply", "obj", "stl", "fbx", "3mf", "x3d", "dae", "glb"};
  std::vector<std::string> formats;
  for (size_t begin = 0; begin <= options.formats.size();) {
    const size_t end = std::min(options.formats.find(',', begin), options.formats.size());
    const std::string format = options.formats.substr(begin, end - begin);
    if (std::find(kKnown.begin(), kKnown.end(), format) == kKnown.end()) {
      throw UsageError(fmt::format("mesh.formats: '{}' is unknown; choose from {}", format, fmt::join(kKnown, ", ")));
    }
    if (std::find(formats.begin(), formats.end(), format) == formats.end()) formats.push_back(format);
    begin = end + 1;
  }
  return formats;
}

namespace {

using Key = std::array<int32_t, 3>;  // of a cube; its corner of least coordinates has the same

constexpr int kTile = 48;         // [cubes] along each side of a tile
constexpr int kReach = 2;         // [cubes] R
constexpr int kSide = kTile + 3;  // corners along each side: the tile's cubes and one beyond on each side

struct Corner {
  double weight = 0, value = 0;
  Eigen::Vector3f colour = Eigen::Vector3f::Zero();  // weighted sum
  int points = 0;
  bool known() const { return points >= 3; }
};

struct Piece {
  std::vector<Key> cubes;  // of the vertices
  std::vector<Eigen::Vector3f> vertices;
  std::vector<cv::Vec3b> colours;
  std::vector<std::array<Key, 3>> triangles;  // by the cubes of their vertices, which may lie in another tile
};

class TileSurface {
 public:
  // First cube of the tile.
  TileSurface(const Key& first, double cell) : first_(first), cell_(cell), corners_(kSide * kSide * kSide) {}

  void add(const CloudPoint& point) {
    const Eigen::Vector3d p = point.position.cast<double>(), n = point.normal.cast<double>();
    const double reach = kReach * cell_;
    const double precision = 1 / (double{point.sigma} * point.sigma + cell_ * cell_ / 16);
    const Eigen::Vector3f colour(point.rgb[0], point.rgb[1], point.rgb[2]);
    Key low, high;
    for (int i = 0; i < 3; ++i) {
      low[i] = std::max(static_cast<int32_t>(std::ceil((p[i] - reach) / cell_)), first_[i] - 1);
      high[i] = std::min(static_cast<int32_t>(std::floor((p[i] + reach) / cell_)), first_[i] + kTile + 1);
    }
    for (int32_t z = low[2]; z <= high[2]; ++z) {
      for (int32_t y = low[1]; y <= high[1]; ++y) {
        for (int32_t x = low[0]; x <= high[0]; ++x) {
          const Eigen::Vector3d from_point = Eigen::Vector3d(x, y, z) * cell_ - p;
          const double part = 1 - from_point.squaredNorm() / (reach * reach);
          if (part <= 0) continue;
          const double weight = part * part * precision;
          Corner& corner = at({x, y, z});
          corner.weight += weight;
          corner.value += weight * n.dot(from_point);
          corner.colour += static_cast<float>(weight) * colour;
          ++corner.points;
        }
      }
    }
  }

  Piece extract() {
    Piece piece;
    Key k;
    for (k[2] = first_[2]; k[2] < first_[2] + kTile; ++k[2]) {
      for (k[1] = first_[1]; k[1] < first_[1] + kTile; ++k[1]) {
        for (k[0] = first_[0]; k[0] < first_[0] + kTile; ++k[0]) {
          add_vertex(k, piece);
          for (int axis = 0; axis < 3; ++axis) add_quad(k, axis, piece);
        }
      }
    }
    return piece;
  }

 private:
  Corner& at(const Key& k) {
    const auto x = static_cast<size_t>(k[0] - first_[0] + 1), y = static_cast<size_t>(k[1] - first_[1] + 1),
               z = static_cast<size_t>(k[2] - first_[2] + 1);
    return corners_[(z * kSide + y) * kSide + x];
  }

  static Key moved(Key k, int bits) {
    for (int i = 0; i < 3; ++i) k[i] += bits >> i & 1;
    return k;
  }

  bool whole(const Key& cube) {
    for (int i = 0; i < 8; ++i) {
      if (!at(moved(cube, i)).known()) return false;
    }
    return true;
  }

  // The vertex of a cube that the surface crosses.
  void add_vertex(const Key& cube, Piece& piece) {
    if (!at(cube).known() || !whole(cube)) return;
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();
    int crossings = 0;
    for (int i = 0; i < 8; ++i) {
      for (int axis = 0; axis < 3; ++axis) {
        if (i >> axis & 1) continue;
        const Corner &a = at(moved(cube, i)), &b = at(moved(cube, i | 1 << axis));
        const double fa = a.value / a.weight, fb = b.value / b.weight;
        if ((fa < 0) == (fb < 0)) continue;
        const Key k = moved(cube, i);
        Eigen::Vector3d crossing(k[0], k[1], k[2]);
        crossing[axis] += fa / (fa - fb);
        sum += crossing;
        ++crossings;
      }
    }
    if (crossings == 0) return;
    Eigen::Vector3f colour = Eigen::Vector3f::Zero();
    double weight = 0;
    for (int i = 0; i < 8; ++i) {
      colour += at(moved(cube, i)).colour;
      weight += at(moved(cube, i)).weight;
    }
    colour /= static_cast<float>(weight);
    piece.cubes.push_back(cube);
    piece.vertices.push_back((sum / crossings * cell_).cast<float>());
    piece.colours.push_back({cv::saturate_cast<uint8_t>(colour[2]), cv::saturate_cast<uint8_t>(colour[1]),
                             cv::saturate_cast<uint8_t>(colour[0])});
  }

  // Two triangles across the edge from corner k along an axis, if the surface crosses it amid four whole cubes.
  void add_quad(const Key& k, int axis, Piece& piece) {
    const Corner &a = at(k), &b = at(moved(k, 1 << axis));
    if (!a.known() || !b.known() || (a.value < 0) == (b.value < 0)) return;
    const int u = (axis + 1) % 3, v = (axis + 2) % 3;
    std::array<Key, 4> cubes = {k, k, k, k};  // counter-clockwise seen along -axis
    cubes[0][u] -= 1;
    cubes[0][v] -= 1;
    cubes[1][v] -= 1;
    cubes[3][u] -= 1;
    for (const Key& cube : cubes) {
      if (!whole(cube)) return;
    }
    // The outside, where f > 0, is where the triangles' front is.
    if (b.value < 0) std::swap(cubes[1], cubes[3]);
    piece.triangles.push_back({cubes[0], cubes[1], cubes[2]});
    piece.triangles.push_back({cubes[0], cubes[2], cubes[3]});
  }

  Key first_;
  double cell_;
  std::vector<Corner> corners_;
};

struct KeyHash {
  size_t operator()(const Key& k) const {
    uint64_t h = static_cast<uint32_t>(k[0]) * 0x9E3779B97F4A7C15ull;
    h = (h ^ static_cast<uint32_t>(k[1])) * 0xC2B2AE3D27D4EB4Full;
    h = (h ^ (h >> 29) ^ static_cast<uint32_t>(k[2])) * 0x165667B19E3779F9ull;
    return static_cast<size_t>(h ^ (h >> 32));
  }
};

// Indices of the points that each tile needs, tiles in the order of their keys, points in that of the cloud.
std::map<Key, std::vector<int>> points_of_tiles(const PointCloud& cloud, double cell) {
  const double side = kTile * cell, margin = (kReach + 1) * cell;
  std::map<Key, std::vector<int>> tiles;
  for (int i = 0; i < static_cast<int>(cloud.points.size()); ++i) {
    const CloudPoint& point = cloud.points[static_cast<size_t>(i)];
    if (point.normal.squaredNorm() == 0) continue;
    Key low, high;
    for (int k = 0; k < 3; ++k) {
      low[k] = static_cast<int32_t>(std::floor((point.position[k] - margin) / side));
      high[k] = static_cast<int32_t>(std::floor((point.position[k] + margin) / side));
    }
    for (int32_t z = low[2]; z <= high[2]; ++z) {
      for (int32_t y = low[1]; y <= high[1]; ++y) {
        for (int32_t x = low[0]; x <= high[0]; ++x) tiles[{x, y, z}].push_back(i);
      }
    }
  }
  return tiles;
}

TriangleMesh surface_with(const PointCloud& cloud, double cell, int max_triangles,
                          const pipeline::RunControl& control) {
  const std::map<Key, std::vector<int>> points = points_of_tiles(cloud, cell);
  const std::vector<std::pair<Key, std::vector<int>>> tiles(points.begin(), points.end());
  TriangleMesh mesh;
  std::unordered_map<Key, int, KeyHash> vertex_of_cube;
  std::vector<std::array<Key, 3>> triangles;
  const int count = static_cast<int>(tiles.size());
  constexpr int kBatch = 16;
  for (int begin = 0; begin < count; begin += kBatch) {
    if (control.stopped()) throw Interrupted();
    const int end = std::min(begin + kBatch, count);
    std::vector<Piece> pieces(static_cast<size_t>(end - begin));
    parallel_chunks(begin, end, 1, [&](int i, int) {
      const auto& [key, indices] = tiles[static_cast<size_t>(i)];
      TileSurface tile({key[0] * kTile, key[1] * kTile, key[2] * kTile}, cell);
      for (const int index : indices) tile.add(cloud.points[static_cast<size_t>(index)]);
      pieces[static_cast<size_t>(i - begin)] = tile.extract();
    });
    for (const Piece& piece : pieces) {
      for (size_t i = 0; i < piece.vertices.size(); ++i) {
        vertex_of_cube.emplace(piece.cubes[i], static_cast<int>(mesh.vertices.size()));
        mesh.vertices.push_back(piece.vertices[i]);
        mesh.vertex_colours.push_back(piece.colours[i]);
      }
      triangles.insert(triangles.end(), piece.triangles.begin(), piece.triangles.end());
    }
    if (triangles.size() > static_cast<size_t>(max_triangles)) return mesh;  // without triangles: too many
  }
  for (const std::array<Key, 3>& triangle : triangles) {
    mesh.triangles.emplace_back(vertex_of_cube.at(triangle[0]), vertex_of_cube.at(triangle[1]),
                                vertex_of_cube.at(triangle[2]));
  }
  return mesh;
}

// Removes separate pieces with fewer triangles, and vertices without any.
void drop_small_parts(TriangleMesh& mesh, int min_triangles) {
  std::vector<int> part(mesh.vertices.size());
  std::iota(part.begin(), part.end(), 0);
  const auto root = [&](int i) {
    while (part[static_cast<size_t>(i)] != i) {
      i = part[static_cast<size_t>(i)] = part[static_cast<size_t>(part[static_cast<size_t>(i)])];
    }
    return i;
  };
  for (const Eigen::Vector3i& t : mesh.triangles) {
    for (int i = 1; i < 3; ++i) {
      const int a = root(t[0]), b = root(t[i]);
      part[static_cast<size_t>(std::max(a, b))] = std::min(a, b);
    }
  }
  std::vector<int> size(mesh.vertices.size(), 0);
  for (const Eigen::Vector3i& t : mesh.triangles) ++size[static_cast<size_t>(root(t[0]))];
  std::erase_if(mesh.triangles,
                [&](const Eigen::Vector3i& t) { return size[static_cast<size_t>(root(t[0]))] < min_triangles; });
  std::vector<int> renumbered(mesh.vertices.size(), -1);
  int kept = 0;
  for (const Eigen::Vector3i& t : mesh.triangles) {
    for (int i = 0; i < 3; ++i) renumbered[static_cast<size_t>(t[i])] = 0;
  }
  for (size_t i = 0; i < renumbered.size(); ++i) {
    if (renumbered[i] < 0) continue;
    mesh.vertices[static_cast<size_t>(kept)] = mesh.vertices[i];
    mesh.vertex_colours[static_cast<size_t>(kept)] = mesh.vertex_colours[i];
    renumbered[i] = kept++;
  }
  mesh.vertices.resize(static_cast<size_t>(kept));
  mesh.vertex_colours.resize(static_cast<size_t>(kept));
  for (Eigen::Vector3i& t : mesh.triangles) {
    for (int i = 0; i < 3; ++i) t[i] = renumbered[static_cast<size_t>(t[i])];
  }
}

}  // namespace

TriangleMesh surface_of(const PointCloud& cloud, const MeshOptions& options, const pipeline::RunControl& control) {
  // A surface finer than the points would be full of holes.
  double cell = std::max(options.cell, 1.5 * cloud.edge);
  TriangleMesh mesh = surface_with(cloud, cell, options.max_triangles, control);
  while (mesh.triangles.empty() && !mesh.vertices.empty() && cell < 1000) {
    cell *= 2;
    mesh = surface_with(cloud, cell, options.max_triangles, control);
  }
  drop_small_parts(mesh, options.min_part);
  mesh.name = "surface";
  spdlog::info("mesh: {} triangles, {} vertices, cubes of {:.3g} m", mesh.triangles.size(), mesh.vertices.size(), cell);
  return mesh;
}

}  // namespace iris::exporters
