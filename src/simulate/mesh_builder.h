// Scenes from simple bodies, with texture coordinates in metres and light that is part of the colours.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <string>
#include <tuple>
#include <vector>

#include "iris/simulate/scene.h"
#include "texture.h"

namespace iris::simulate {

using Vector2 = Eigen::Vector2d;
using Vector3 = Eigen::Vector3d;

// What a surface is made of. The name stands for it: two materials of one scene have different names.
struct Material {
  std::string name;
  Texture texture;                  // without image: `colour` everywhere, which stereo cannot measure
  cv::Vec3b colour{200, 200, 200};  // BGR
  bool shaded = true;               // faces that turn away from the light are darker
  // Walls, floors and ceilings: makes the texture of one of them, of its size; no two of them look alike.
  std::function<Texture(uint32_t seed, const Extent& extent)> cover = {};
  uint32_t seed = 0;  // of `cover`
};
inline Material plain(const std::string& name, const cv::Vec3b& colour) { return {.name = name, .colour = colour}; }
inline Material with_texture(const std::string& name, Texture texture, bool shaded = true) {
  return {.name = name, .texture = std::move(texture), .shaded = shaded};
}

inline Material covering(const std::string& name, uint32_t seed,
                         std::function<Texture(uint32_t seed, const Extent& extent)> cover) {
  return {.name = name, .shaded = false, .cover = std::move(cover), .seed = seed};
}

// An opening in a wall, in metres along the wall and above the floor.
struct Opening {
  double from, to, bottom, top;
};

// Bodies are given in the frame of `place`, z up. Each group, material and brightness becomes one object. Faces never
// coincide if bodies overlap or keep apart.
class MeshBuilder {
 public:
  // Name of what is built next (a room, a piece of furniture).
  void group(const std::string& name) { group_ = name; }
  void place(const Pose& world_from_local) { world_from_local_ = world_from_local; }
  void place(double x, double y, double z = 0, double yaw_degrees = 0);

  // The material of the next surface of width x height metres: one of its own where the material covers, else as given.
  Material surface(const Material& material, double width, double height);

  // The rectangle from the upper-left `corner`, as seen from where its front is seen: `right` and `down` are its edges.
  // Texture in metres from `uv` on.
  void quad(const Material& material, const Vector3& corner, const Vector3& right, const Vector3& down,
            const Vector2& uv = Vector2::Zero());
  // The same with the whole texture shown once.
  void picture(const Material& material, const Vector3& corner, const Vector3& right, const Vector3& down);
  // Texture coordinates [m]; seen counter-clockwise from outside.
  void triangle(const Material& material, const Vector3& a, const Vector3& b, const Vector3& c, const Vector2& uv_a,
                const Vector2& uv_b, const Vector2& uv_c);
  // Grain (u) runs along the longer edge of each face. Each face shows another part of the texture, at its own scale
  // and half of them mirrored.
  void box(const Material& material, const Vector3& low, const Vector3& high);
  // A tube or cone with caps.
  void cylinder(const Material& material, const Vector3& from, const Vector3& to, double radius_from, double radius_to,
                int segments = 12);
  void ellipsoid(const Material& material, const Vector3& centre, const Vector3& radii, int segments = 12);
  // z = height(x, y) over a grid, seen from above; texture coordinates are about x and -y.
  void height_field(const Material& material, const Vector2& low, const Vector2& high, int columns, int rows,
                    const std::function<double(double x, double y)>& height);
  // The inner face of a wall in the plane y = 0 of the frame from x = 0 to `length`, seen from y < 0, without what the
  // openings cut out; and a skirting board where there is a material for it.
  void wall(const Material& material, double length, double height, const std::vector<Opening>& openings,
            const Material* skirting);

  std::vector<SceneObject> take();

 private:
  struct Vertex {
    Vector3 point;
    Vector2 uv;  // in tiles
  };
  TriangleMesh& mesh_for(const Material& material, const Vector3& normal_in_local);
  void polygon(const Material& material, const std::vector<Vertex>& vertices);
  static Vector2 tiles_of(const Material& material, const Vector2& metres);

  std::string group_ = "scene";
  Pose world_from_local_ = Pose::Identity();
  std::vector<SceneObject> objects_;
  std::map<std::tuple<std::string, std::string, int>, size_t> index_;
  std::map<std::pair<std::string, int>, cv::Mat3b> shaded_;
  std::map<std::string, uint32_t> surfaces_;  // covered with each material
};

}  // namespace iris::simulate
