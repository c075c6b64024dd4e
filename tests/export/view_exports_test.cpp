// The views for COLMAP and nerfstudio, read back by what is written here from the formats' documentation alone.
#include "export/view_exports.h"

#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <map>
#include <nlohmann/json.hpp>
#include <opencv2/imgcodecs.hpp>
#include <sstream>

#include "iris/core/atomic_file.h"
#include "support/box_room.h"
#include "support/temporary_folder.h"

namespace iris::exporters {
namespace {

namespace fs = std::filesystem;
using Eigen::Vector3d;
using testing::TemporaryFolder;

RectifiedCamera camera() {
  return {.f = 150, .cx = 78.3, .cy = 61.2, .baseline = 0.12, .disparity_offset = 1.5, .width = 160, .height = 120};
}

class ViewExports : public ::testing::Test {
 protected:
  void SetUp() override {
    for (int i = 0; i < 6; ++i) {
      StereoView view =
          testing::view_of(room_, camera(), testing::level_camera({-0.6 + 0.2 * i, 0.1 * i, 0.05 * i}, 0.2 * i, 0.1));
      view.frame_idx = 3 * i;
      views_.push_back(view);
    }
    store_ = std::make_unique<views::MemoryViewStore>(views_);
  }
  // Distance of a point from the nearest wall of the room.
  double off_wall(const Vector3d& p) const {
    double least = 1e9;
    for (int a = 0; a < 3; ++a)
      least = std::min({least, std::abs(p[a] - room_.low[a]), std::abs(p[a] - room_.high[a])});
    return least;
  }
  testing::BoxRoom room_;
  std::vector<StereoView> views_;
  std::unique_ptr<views::MemoryViewStore> store_;
  TemporaryFolder folder_;
};

std::vector<std::string> data_lines(const fs::path& file) {
  std::ifstream in(file);
  std::vector<std::string> lines;
  for (std::string line; std::getline(in, line);) {
    if (line.empty() || line[0] != '#') lines.push_back(line);
  }
  return lines;
}

TEST_F(ViewExports, PointsLieOnTheWallsAndAreSeenBySeveralViews) {
  const std::vector<ScenePoint> points = scene_points(*store_);
  ASSERT_GT(points.size(), 100u);
  double observations = 0;
  for (const ScenePoint& point : points) {
    EXPECT_LT(off_wall(point.position), 1e-4);
    ASSERT_FALSE(point.observations.empty());
    EXPECT_LT(point.error, 1);
    observations += static_cast<double>(point.observations.size());
    for (const ScenePoint::Observation& o : point.observations) {
      const StereoView& view = views_[static_cast<size_t>(o.view_idx)];
      const Vector3d pixel = view.camera.project(view.world_from_cam.inverse() * point.position);
      EXPECT_NEAR(pixel.x(), o.x, 1e-3);
      EXPECT_NEAR(pixel.y(), o.y, 1e-3);
    }
  }
  EXPECT_GT(observations / static_cast<double>(points.size()), 2);
  // Far fewer than a point a square of every view: they are not made twice.
  EXPECT_LT(points.size(), 6 * 10 * 8 * 0.8);
}

TEST_F(ViewExports, ColmapsModelProjectsItsPointsOntoItsObservations) {
  write_colmap(folder_.path() / "colmap", *store_, {});
  const fs::path model = folder_.path() / "colmap/sparse/0";
  const auto cameras = data_lines(model / "cameras.txt");
  ASSERT_EQ(cameras.size(), 1u);
  std::istringstream in(cameras[0]);
  int id, width, height;
  std::string name;
  double fx, fy, cx, cy;
  in >> id >> name >> width >> height >> fx >> fy >> cx >> cy;
  EXPECT_EQ(name, "PINHOLE");
  EXPECT_EQ(width, 160);
  EXPECT_EQ(height, 120);
  EXPECT_EQ(fx, 150);
  EXPECT_EQ(fy, 150);
  EXPECT_DOUBLE_EQ(cx, 78.8);  // the upper-left pixel's centre is (0.5, 0.5)
  EXPECT_DOUBLE_EQ(cy, 61.7);

  struct Point {
    Vector3d at;
    std::vector<std::pair<int, int>> track;
  };
  std::map<long, Point> points;
  for (const std::string& line : data_lines(model / "points3D.txt")) {
    std::istringstream row(line);
    long point_id;
    double r, g, b, error;
    Point point;
    row >> point_id >> point.at.x() >> point.at.y() >> point.at.z() >> r >> g >> b >> error;
    int image, index;
    while (row >> image >> index) point.track.emplace_back(image, index);
    EXPECT_GE(point.track.size(), 1u);
    points[point_id] = point;
  }
  ASSERT_GT(points.size(), 100u);

  const auto lines = data_lines(model / "images.txt");
  ASSERT_EQ(lines.size(), 12u);
  size_t observations = 0;
  for (size_t i = 0; i < 6; ++i) {
    std::istringstream row(lines[2 * i]);
    int image_id, camera_id;
    double qw, qx, qy, qz, tx, ty, tz;
    std::string file;
    row >> image_id >> qw >> qx >> qy >> qz >> tx >> ty >> tz >> camera_id >> file;
    EXPECT_EQ(camera_id, 1);
    const cv::Mat image = cv::imread((folder_.path() / "colmap/images" / file).string());
    EXPECT_EQ(image.size(), cv::Size(160, 120));
    EXPECT_EQ(cv::norm(image, views_[i].image), 0);
    // Rotation by the quaternion, written out: v + 2 q x (q x v + w v).
    const auto project = [&](const Vector3d& v) {
      const Vector3d q(qx, qy, qz);
      const Vector3d p = v + 2 * q.cross(q.cross(v) + qw * v) + Vector3d(tx, ty, tz);
      return Vector3d(fx * p.x() / p.z() + cx, fy * p.y() / p.z() + cy, p.z());
    };
    EXPECT_NEAR(qw * qw + qx * qx + qy * qy + qz * qz, 1, 1e-12);
    std::istringstream second(lines[2 * i + 1]);
    double x, y;
    long point_id;
    for (int index = 0; second >> x >> y >> point_id; ++index) {
      ASSERT_TRUE(points.contains(point_id));
      const Vector3d pixel = project(points[point_id].at);
      EXPECT_GT(pixel.z(), 0);
      EXPECT_NEAR(pixel.x(), x, 1e-3);
      EXPECT_NEAR(pixel.y(), y, 1e-3);
      const auto& track = points[point_id].track;
      EXPECT_NE(std::find(track.begin(), track.end(), std::pair(image_id, index)), track.end());
      ++observations;
    }
  }
  size_t in_tracks = 0;
  for (const auto& [point_id, point] : points) in_tracks += point.track.size();
  EXPECT_EQ(observations, in_tracks);
}

TEST_F(ViewExports, NerfstudiosCamerasAndDepthLeadToTheWalls) {
  const fs::path folder = folder_.path() / "nerfstudio";
  write_nerfstudio(folder, *store_, {});
  const auto content = nlohmann::json::parse(read_file(folder / "transforms.json"));
  EXPECT_EQ(content["w"], 160);
  EXPECT_EQ(content["h"], 120);
  ASSERT_EQ(content["frames"].size(), 6u);
  for (size_t i = 0; i < 6; ++i) {
    const auto& frame = content["frames"][i];
    const cv::Mat1w depth =
        cv::imread((folder / frame["depth_file_path"].get<std::string>()).string(), cv::IMREAD_UNCHANGED);
    const cv::Mat image = cv::imread((folder / frame["file_path"].get<std::string>()).string());
    ASSERT_EQ(depth.size(), cv::Size(160, 120));
    EXPECT_EQ(cv::norm(image, views_[i].image), 0);
    Eigen::Matrix4d m;
    for (int row = 0; row < 4; ++row) {
      for (int column = 0; column < 4; ++column) m(row, column) = frame["transform_matrix"][row][column];
    }
    EXPECT_NEAR((m.topLeftCorner<3, 3>().determinant()), 1, 1e-9);
    EXPECT_GT(m(2, 1), 0.9);  // the camera's y is up
    for (int y = 5; y < 120; y += 13) {
      for (int x = 5; x < 160; x += 13) {
        ASSERT_GT(depth(y, x), 0);
        const double z = depth(y, x) / 1000.0;
        // OpenGL: x right, y up, looking along -z; pixel centres at +0.5.
        const Eigen::Vector4d in_cam((x + 0.5 - content["cx"].get<double>()) / content["fl_x"].get<double>() * z,
                                     -(y + 0.5 - content["cy"].get<double>()) / content["fl_y"].get<double>() * z, -z,
                                     1);
        EXPECT_LT(off_wall((m * in_cam).head<3>()), 1e-3) << i << " " << x << " " << y;
      }
    }
  }
  // The points: an ASCII PLY, as many rows as it says.
  std::ifstream ply(folder / content["ply_file_path"].get<std::string>());
  size_t count = 0, rows = 0;
  std::string line;
  while (std::getline(ply, line) && line != "end_header") {
    if (line.starts_with("element vertex ")) count = std::stoul(line.substr(15));
  }
  for (Vector3d p; std::getline(ply, line); ++rows) {
    std::istringstream(line) >> p.x() >> p.y() >> p.z();
    EXPECT_LT(off_wall(p), 1e-3);
  }
  EXPECT_EQ(rows, count);
  EXPECT_GT(count, 100u);
}

TEST_F(ViewExports, DisparitiesThatWereFilledInMakeNoPoints) {
  for (StereoView& view : views_) view.disparity.origin = static_cast<uint8_t>(DisparityOrigin::between_segments);
  EXPECT_TRUE(scene_points(views::MemoryViewStore(views_)).empty());
}

}  // namespace
}  // namespace iris::exporters
