#include "mesh_builder.h"

#include <algorithm>
#include <cmath>

#include "iris/core/error.h"

namespace iris::simulate {

namespace {

constexpr int kShades = 6;

// Brightness of a face, in steps so that few copies of a texture are needed: most light comes from above.
int shade_of(const Vector3& normal) {
  const Vector3 light = Vector3(0.30, -0.45, 0.84).normalized();
  return std::clamp(static_cast<int>(std::lround((normal.dot(light) + 1) / 2 * (kShades - 1))), 0, kShades - 1);
}

// 256 = as the texture is.
int gain_of(int shade) { return 256 - 24 * (kShades - 1 - shade); }

uint8_t scaled(uint8_t value, int gain) { return static_cast<uint8_t>((value * gain + 128) >> 8); }

cv::Vec3b scaled(const cv::Vec3b& colour, int gain) {
  return {scaled(colour[0], gain), scaled(colour[1], gain), scaled(colour[2], gain)};
}

// What part of a texture a face shows: equal content at two places would be mistaken for the same place. Textures are
// larger than most faces, but not so large that parts never overlap; mirrored or of another scale, they do not match.
struct Cut {
  Vector2 start;  // [m]
  Vector2 scale;  // of the texture; u negative: mirrored
  Vector2 at(double u, double v) const { return start + scale.cwiseProduct(Vector2(u, v)); }
};
Cut cut_of(const Vector3& point, uint32_t salt) {
  const auto mm = [](double x) { return static_cast<uint32_t>(static_cast<int32_t>(std::lround(x * 1000))); };
  Random random(hash(mm(point.x()), mm(point.y()), mm(point.z()), salt));
  const Vector2 start(random.uniform(0, 10.24), random.uniform(0, 10.24));
  const double scale = random.uniform(0.8, 1.25);
  return {start, {random.below(2) ? -scale : scale, scale}};
}

}  // namespace

void MeshBuilder::place(double x, double y, double z, double yaw_degrees) {
  world_from_local_ = Pose::Identity();
  // Exact for quarter turns, so that furniture stands parallel to the walls.
  const double quarter = yaw_degrees / 90;
  if (quarter == std::round(quarter)) {
    const int q = ((static_cast<int>(quarter) % 4) + 4) % 4;
    const double c = q == 0 ? 1 : q == 2 ? -1 : 0, s = q == 1 ? 1 : q == 3 ? -1 : 0;
    world_from_local_.linear() << c, -s, 0, s, c, 0, 0, 0, 1;
  } else {
    world_from_local_.linear() = Eigen::AngleAxisd(yaw_degrees * M_PI / 180, Vector3::UnitZ()).matrix();
  }
  world_from_local_.translation() = Vector3(x, y, z);
}

TriangleMesh& MeshBuilder::mesh_for(const Material& material, const Vector3& normal_in_local) {
  const int shade = material.shaded ? shade_of(world_from_local_.linear() * normal_in_local) : kShades - 1;
  const auto [found, added] = index_.try_emplace({group_, material.name, shade}, objects_.size());
  if (!added) return objects_[found->second].mesh;
  objects_.emplace_back();
  SceneObject& object = objects_.back();
  object.mesh.name = group_;
  object.mesh.name.append(": ").append(material.name);
  if (material.shaded) object.mesh.name.append(" ").append(std::to_string(shade));
  object.textured = !material.texture.image.empty();
  object.mesh.colour = scaled(material.colour, gain_of(shade));
  if (object.textured) {
    cv::Mat3b& image = shaded_[{material.name, shade}];
    if (image.empty()) {
      image = material.texture.image;
      if (gain_of(shade) != 256) {
        image = image.clone();
        for (cv::Vec3b& pixel : image) pixel = scaled(pixel, gain_of(shade));
      }
    }
    object.mesh.texture = image;
  }
  return object.mesh;
}

Vector2 MeshBuilder::tiles_of(const Material& material, const Vector2& metres) {
  return {metres.x() / material.texture.width, metres.y() / material.texture.height};
}

Material MeshBuilder::surface(const Material& material, double width, double height) {
  if (!material.cover) return material;
  const uint32_t number = ++surfaces_[material.name];
  Material own = material;
  own.name.append(" ").append(std::to_string(number));
  own.texture = material.cover(hash(material.seed, number), {width, height});
  return own;
}

void MeshBuilder::polygon(const Material& material, const std::vector<Vertex>& vertices) {
  const Vector3 normal =
      (vertices[1].point - vertices[0].point).cross(vertices.back().point - vertices[0].point).normalized();
  TriangleMesh& mesh = mesh_for(material, normal);
  const int first = static_cast<int>(mesh.vertices.size());
  for (const Vertex& vertex : vertices) {
    mesh.vertices.push_back((world_from_local_ * vertex.point).cast<float>());
    if (!mesh.texture.empty()) mesh.texture_coordinates.push_back(vertex.uv.cast<float>());
  }
  for (int i = 2; i < static_cast<int>(vertices.size()); ++i)
    mesh.triangles.emplace_back(first, first + i - 1, first + i);
}

void MeshBuilder::quad(const Material& material, const Vector3& corner, const Vector3& right, const Vector3& down,
                       const Vector2& uv) {
  const double width = right.norm(), height = down.norm();
  polygon(material, {{corner, tiles_of(material, uv)},
                     {corner + down, tiles_of(material, uv + Vector2(0, height))},
                     {corner + right + down, tiles_of(material, uv + Vector2(width, height))},
                     {corner + right, tiles_of(material, uv + Vector2(width, 0))}});
}

void MeshBuilder::picture(const Material& material, const Vector3& corner, const Vector3& right, const Vector3& down) {
  polygon(material,
          {{corner, {0, 0}}, {corner + down, {0, 1}}, {corner + right + down, {1, 1}}, {corner + right, {1, 0}}});
}

void MeshBuilder::triangle(const Material& material, const Vector3& a, const Vector3& b, const Vector3& c,
                           const Vector2& uv_a, const Vector2& uv_b, const Vector2& uv_c) {
  polygon(material, {{a, tiles_of(material, uv_a)}, {b, tiles_of(material, uv_b)}, {c, tiles_of(material, uv_c)}});
}

void MeshBuilder::box(const Material& material, const Vector3& low, const Vector3& high) {
  const Vector3 size = high - low;
  IRIS_CHECK(size.minCoeff() > 0);
  const Vector3 x(size.x(), 0, 0), y(0, size.y(), 0), z(0, 0, size.z());
  struct Face {
    Vector3 corner, right, down;
  };
  const Face faces[] = {{low + y + z, x, -y},   // from above
                        {low, x, y},            // from below
                        {low + z, x, -z},       // from -y
                        {high, -x, -z},         // from +y
                        {low + y + z, -y, -z},  // from -x
                        {high - y, y, -z}};     // from +x
  uint32_t salt = 0;
  for (const Face& face : faces) {
    ++salt;
    const Cut cut = cut_of(world_from_local_ * face.corner, salt);
    const double width = face.right.norm(), height = face.down.norm();
    const bool upright = width < height;
    const auto uv = [&](double x, double y) { return tiles_of(material, upright ? cut.at(y, x) : cut.at(x, y)); };
    polygon(material, {{face.corner, uv(0, 0)},
                       {face.corner + face.down, uv(0, height)},
                       {face.corner + face.right + face.down, uv(width, height)},
                       {face.corner + face.right, uv(width, 0)}});
  }
}

void MeshBuilder::cylinder(const Material& material, const Vector3& from, const Vector3& to, double radius_from,
                           double radius_to, int segments) {
  const Vector3 axis = (to - from).normalized();
  const Vector3 a = axis.cross(std::abs(axis.z()) < 0.9 ? Vector3::UnitZ() : Vector3::UnitX()).normalized();
  const Vector3 b = axis.cross(a);
  const double length = (to - from).norm(), around = 2 * M_PI * std::max(radius_from, radius_to);
  const Cut cut = cut_of(world_from_local_ * from, 7);
  const auto on = [&](int i) -> Vector3 {
    const double angle = 2 * M_PI * (i % segments) / segments;
    return std::cos(angle) * a + std::sin(angle) * b;
  };
  std::vector<Vertex> bottom, top;
  for (int i = 0; i < segments; ++i) {
    const Vector3 here = on(i), next = on(i + 1);
    const double u0 = around * i / segments, u1 = around * (i + 1) / segments;
    std::vector<Vertex> side;
    side.push_back({from + radius_from * here, tiles_of(material, cut.at(0, u0))});
    if (radius_from > 0) side.push_back({from + radius_from * next, tiles_of(material, cut.at(0, u1))});
    side.push_back({to + radius_to * next, tiles_of(material, cut.at(length, u1))});
    if (radius_to > 0) side.push_back({to + radius_to * here, tiles_of(material, cut.at(length, u0))});
    polygon(material, side);
    const auto flat = [&](const Vector3& p, double r) {
      return tiles_of(material, cut.at(r * p.dot(a), r * p.dot(b)));
    };
    bottom.push_back({from + radius_from * here, flat(here, radius_from)});
    top.push_back({to + radius_to * here, flat(here, radius_to)});
  }
  std::reverse(bottom.begin(), bottom.end());
  if (radius_from > 0) polygon(material, bottom);
  if (radius_to > 0) polygon(material, top);
}

void MeshBuilder::ellipsoid(const Material& material, const Vector3& centre, const Vector3& radii, int segments) {
  const int rings = std::max(3, segments / 2);
  const auto at = [&](int i, int j) -> Vector3 {
    const double around = 2 * M_PI * (i % segments) / segments, up = M_PI * j / rings;
    const double s = j == 0 || j == rings ? 0 : std::sin(up);
    return centre +
           Vector3(radii.x() * s * std::cos(around), radii.y() * s * std::sin(around), radii.z() * std::cos(up));
  };
  const double width = 2 * M_PI * std::max(radii.x(), radii.y()), height = M_PI * radii.z();
  const Cut cut = cut_of(world_from_local_ * centre, 8);
  const auto uv = [&](int i, int j) { return tiles_of(material, cut.at(width * i / segments, height * j / rings)); };
  for (int j = 0; j < rings; ++j) {
    for (int i = 0; i < segments; ++i) {
      std::vector<Vertex> face = {{at(i, j), uv(i, j)}, {at(i, j + 1), uv(i, j + 1)}};
      if (j + 1 < rings) face.push_back({at(i + 1, j + 1), uv(i + 1, j + 1)});
      if (j > 0) face.push_back({at(i + 1, j), uv(i + 1, j)});
      polygon(material, face);
    }
  }
}

void MeshBuilder::height_field(const Material& material, const Vector2& low, const Vector2& high, int columns, int rows,
                               const std::function<double(double x, double y)>& height) {
  TriangleMesh& mesh = mesh_for(material, Vector3::UnitZ());
  const int first = static_cast<int>(mesh.vertices.size());
  for (int j = 0; j <= rows; ++j) {
    for (int i = 0; i <= columns; ++i) {
      const double x = low.x() + (high.x() - low.x()) * i / columns, y = low.y() + (high.y() - low.y()) * j / rows;
      mesh.vertices.push_back((world_from_local_ * Vector3(x, y, height(x, y))).cast<float>());
      // Bent a little, elsewhere in another way: the texture does not repeat exactly.
      const Vector2 bent(x + 0.5 * std::sin(0.21 * y + 1), -y + 0.5 * std::sin(0.17 * x));
      if (!mesh.texture.empty()) mesh.texture_coordinates.push_back(tiles_of(material, bent).cast<float>());
    }
  }
  for (int j = 0; j < rows; ++j) {
    for (int i = 0; i < columns; ++i) {
      const int a = first + j * (columns + 1) + i, b = a + 1, c = a + columns + 1, d = c + 1;
      mesh.triangles.emplace_back(a, b, d);
      mesh.triangles.emplace_back(a, d, c);
    }
  }
}

void MeshBuilder::wall(const Material& material, double length, double height, const std::vector<Opening>& openings,
                       const Material* skirting) {
  std::vector<double> xs = {0, length}, zs = {0, height};
  for (const Opening& opening : openings) {
    xs.insert(xs.end(), {opening.from, opening.to});
    zs.insert(zs.end(), {opening.bottom, opening.top});
  }
  for (std::vector<double>* cuts : {&xs, &zs}) {
    std::sort(cuts->begin(), cuts->end());
    cuts->erase(std::unique(cuts->begin(), cuts->end()), cuts->end());
  }
  constexpr double kThick = 0.012, kHigh = 0.07;
  for (size_t i = 0; i + 1 < xs.size(); ++i) {
    for (size_t j = 0; j + 1 < zs.size(); ++j) {
      const double x = (xs[i] + xs[i + 1]) / 2, z = (zs[j] + zs[j + 1]) / 2;
      const bool open = std::any_of(openings.begin(), openings.end(), [&](const Opening& o) {
        return x > o.from && x < o.to && z > o.bottom && z < o.top;
      });
      if (open) continue;
      quad(material, {xs[i], 0, zs[j + 1]}, {xs[i + 1] - xs[i], 0, 0}, {0, 0, zs[j] - zs[j + 1]},
           {xs[i], height - zs[j + 1]});
      if (skirting && j == 0) {
        const double from = i == 0 ? xs[i] + kThick + 0.001 : xs[i],
                     to = i + 2 == xs.size() ? xs[i + 1] - 0.001 : xs[i + 1];
        box(*skirting, {from, -kThick, 0.002}, {to, 0.003, kHigh});
      }
    }
  }
}

std::vector<SceneObject> MeshBuilder::take() {
  std::vector<SceneObject> objects;
  objects.swap(objects_);
  index_.clear();
  return objects;
}

}  // namespace iris::simulate
