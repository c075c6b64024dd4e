// Tours as users make them: every path, every output, resumed after any interruption; and the exports of views.
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>

#include <algorithm>
#include <chrono>
#include <cstdlib>
#include <functional>
#include <map>
#include <nlohmann/json.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/videoio.hpp>
#include <random>

#include "iris/core/atomic_file.h"
#include "support/program.h"
#include "support/synthetic_session.h"
#include "support/temporary_folder.h"

namespace iris {
namespace {

namespace fs = std::filesystem;
using iris::testing::ProgramResult;
using iris::testing::run_program;
using iris::testing::TemporaryFolder;
using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

class Tours : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    folder_ = new TemporaryFolder;
    iris::testing::write_synthetic_session(folder_->path() / "session", 14);
    const auto result =
        run_program({"run", (folder_->path() / "session").string(), "-o", out().string(), "--stereo.disparities", "48",
                     "--tour.seconds", "1", "--tour.width", "160", "--tour.height", "120", "--quiet"});
    ASSERT_EQ(result.exit_code, 0) << result.output;
  }
  static void TearDownTestSuite() {
    delete folder_;
    folder_ = nullptr;
  }
  static fs::path out() { return folder_->path() / "out"; }
  static fs::path fresh(const std::string& name) {
    fs::remove_all(folder_->path() / name);
    return folder_->path() / name;
  }
  static std::vector<std::string> arguments(const std::vector<std::string>& more) {
    std::vector<std::string> all = {"tour", out().string()};
    all.insert(all.end(), more.begin(), more.end());
    return all;
  }
  static ProgramResult tour(const std::vector<std::string>& more) { return run_program(arguments(more)); }
  static std::map<std::string, std::string> files_of(const fs::path& folder) {
    std::map<std::string, std::string> files;
    for (const auto& entry : fs::recursive_directory_iterator(folder)) {
      if (entry.is_regular_file()) files[fs::relative(entry.path(), folder).string()] = read_file(entry.path());
    }
    return files;
  }
  static int frames_of(const fs::path& video) {
    cv::VideoCapture reader(video.string(), cv::CAP_FFMPEG);
    int frames = 0;
    for (cv::Mat image; reader.read(image);) ++frames;
    return frames;
  }
  static TemporaryFolder* folder_;
};
TemporaryFolder* Tours::folder_ = nullptr;

TEST_F(Tours, EveryPathMakesAVideo) {
  const fs::path keys = folder_->path() / "keys.json";
  write_file(keys, R"({"fps": 10, "width": 96, "height": 64, "keyframes": [
    {"t": 0, "position": [0, 0, 0.2], "look_at": [2, 0, 0.2], "caption": "First"},
    {"t": 0.4, "position": [0.1, 0.2, 0.2], "yaw": 10}]})");
  const std::vector<std::vector<std::string>> paths = {
      {"orbit", "--tour.seconds", "0.5"},
      {"orbit", "--centre", "2,0,0", "--tour.radius", "1", "--tour.seconds", "0.5"},
      {"panorama", "--tour.seconds", "0.5"},
      {"follow", "--tour.swing", "30", "--tour.seconds", "0.5"},
      {"fixed", "--tour.seconds", "0.5"},
      {keys.string()}};
  for (const std::vector<std::string>& path : paths) {
    const fs::path video = fresh("path.mp4");
    std::vector<std::string> arguments = {"-o", video.string(), "--preview", "--quiet", "--path"};
    arguments.insert(arguments.end(), path.begin(), path.end());
    const auto result = tour(arguments);
    EXPECT_EQ(result.exit_code, 0) << path[0] << ": " << result.output;
    EXPECT_GE(frames_of(video), 5) << path[0];
    EXPECT_FALSE(fs::exists(folder_->path() / "path.mp4.frames")) << path[0];
  }
}

TEST_F(Tours, TheCommandLineWinsOverACameraPathFileAndTheFileOverTheRun) {
  const fs::path keys = folder_->path() / "settings.json";
  write_file(keys, R"({"fps": 10, "width": 96, "height": 64, "fov": 50, "ease": 0.1, "keyframes": [
    {"t": 0, "position": [0, 0, 0.2]}, {"t": 0.4, "position": [0.1, 0.2, 0.2], "yaw": 10}]})");
  const auto record_with = [&](std::vector<std::string> more) {
    const fs::path pictures = fresh("settings");
    more.insert(more.end(), {"--path", keys.string(), "-o", pictures.string(), "--quiet"});
    const auto result = tour(more);
    EXPECT_EQ(result.exit_code, 0) << result.output;
    return nlohmann::json::parse(read_file(pictures / "tour.json"));
  };
  const double half = std::tan(25 * M_PI / 180);
  // The run was made with 160 x 120 and 1 s.
  const auto file = record_with({});
  EXPECT_EQ(file["width"], 96);
  EXPECT_EQ(file["height"], 64);
  EXPECT_EQ(file["fps"], 10);
  EXPECT_EQ(file["frames"].size(), 5u);
  EXPECT_NEAR(file["frames"][0]["f"].get<double>(), 32 / half, 1e-9);
  const auto given = record_with({"--tour.width", "80", "--tour.fps", "20", "--tour.fov", "90"});
  EXPECT_EQ(given["width"], 80);
  EXPECT_EQ(given["height"], 64);
  EXPECT_EQ(given["fps"], 20);
  EXPECT_EQ(given["frames"].size(), 9u);
  for (const auto& frame : given["frames"]) EXPECT_NEAR(frame["f"].get<double>(), 32, 1e-9);
  const auto longer = record_with({"--tour.height", "48", "--tour.seconds", "0.8", "--tour.ease", "0"});
  EXPECT_EQ(longer["height"], 48);
  EXPECT_EQ(longer["frames"].size(), 9u);
  // Without gathering speed, the middle of the spline of two keyframes is the middle of them after half of the time.
  EXPECT_NEAR(longer["frames"][4]["world_from_camera"][7].get<double>(), 0.1, 1e-9);
}

TEST_F(Tours, PicturesOfWhatWasNeverSeenAreAnnounced) {
  const fs::path keys = folder_->path() / "backwards.json";
  const auto output_of = [&](double yaw) {
    write_file(keys, fmt::format(R"({{"fps": 10, "keyframes": [{{"t": 0, "position": [0, 0, 0], "yaw": {0}}},
                                     {{"t": 0.3, "position": [0.1, 0, 0], "yaw": {0}}}]}})",
                                 yaw));
    const auto result = tour({"--path", keys.string(), "-o", fresh("seen").string(), "--quiet"});
    EXPECT_EQ(result.exit_code, 0) << result.output;
    return result.output;
  };
  EXPECT_THAT(output_of(180), HasSubstr("4 of 4 pictures show mostly nothing: the recording never looked there"));
  EXPECT_THAT(output_of(0), Not(HasSubstr("mostly nothing")));
}

TEST_F(Tours, EveryOutputHoldsTheSameFrames) {
  const std::vector<std::string> common = {"--tour.seconds", "0.5", "--quiet", "--tour.depth", "both"};
  const auto with = [&](std::vector<std::string> more) {
    more.insert(more.end(), common.begin(), common.end());
    return tour(more);
  };
  const fs::path png = fresh("png"), jpeg = fresh("jpeg"), mp4 = fresh("a.mp4"), webm = fresh("b.webm");
  ASSERT_EQ(with({"-o", png.string() + "/"}).exit_code, 0);
  ASSERT_EQ(with({"-o", jpeg.string(), "--tour.frame_format", "jpeg"}).exit_code, 0);
  ASSERT_EQ(with({"-o", mp4.string(), "--keep-frames"}).exit_code, 0);
  ASSERT_EQ(with({"-o", webm.string()}).exit_code, 0);
  EXPECT_EQ(frames_of(mp4), 6);
  EXPECT_EQ(frames_of(webm), 6);
  for (int i = 0; i < 6; ++i) {
    const std::string name = fmt::format("{:06}", i);
    EXPECT_EQ(read_file(png / (name + ".png")), read_file(fs::path(mp4.string() + ".frames") / (name + ".png")));
    EXPECT_EQ(read_file(png / "depth" / (name + ".png")), read_file(folder_->path() / "b_depth" / (name + ".png")));
    EXPECT_EQ(read_file(png / "depth" / (name + ".exr")), read_file(folder_->path() / "b_depth" / (name + ".exr")));
    EXPECT_EQ(cv::imread((jpeg / (name + ".jpg")).string()).size(), cv::Size(160, 120));
    const cv::Mat1w depth = cv::imread((png / "depth" / (name + ".png")).string(), cv::IMREAD_UNCHANGED);
    EXPECT_GT(cv::countNonZero(depth), 160 * 120 / 2);
  }
  EXPECT_FALSE(fs::exists(folder_->path() / "b.webm.frames"));
  const auto record = nlohmann::json::parse(read_file(png / "tour.json"));
  EXPECT_EQ(record["frames"].size(), 6u);
  EXPECT_EQ(record["width"], 160);
  // The run's own tour is along the path too, of the same pictures.
  EXPECT_TRUE(fs::exists(out() / "tour/frames/tour.json"));
}

TEST_F(Tours, KilledAtRandomMomentsItGoesOnToTheSameResult) {
  const std::vector<std::string> common = {
      "--tour.seconds", "6", "--quiet",      "--keep-frames", "--tour.layout", "side-by-side",
      "--render.step",  "1", "--tour.width", "320",           "--tour.height", "240"};
  const auto with = [&](const fs::path& video) {
    std::vector<std::string> all = arguments({"-o", video.string()});
    all.insert(all.end(), common.begin(), common.end());
    return all;
  };
  const fs::path whole = fresh("whole.mp4"), killed = fresh("killed.mp4");
  fresh("whole.mp4.frames"), fresh("killed.mp4.frames");
  ASSERT_EQ(run_program(with(whole)).exit_code, 0);
  std::mt19937 random(7);
  int kills = 0, gone_on = 0;
  for (int attempt = 0; attempt < 8; ++attempt) {
    const auto time = std::chrono::milliseconds(std::uniform_int_distribution<>(50, 900)(random));
    if (!iris::testing::start_and_kill(with(killed), time)) break;
    ++kills;
    const bool some = fs::exists(killed.string() + ".frames/000000.png");
    EXPECT_FALSE(fs::exists(killed));
    gone_on += some;
  }
  EXPECT_GE(kills, 1);
  const auto last = run_program(with(killed));
  ASSERT_EQ(last.exit_code, 0) << last.output;
  EXPECT_EQ(read_file(whole), read_file(killed));
  EXPECT_EQ(files_of(whole.string() + ".frames"), files_of(killed.string() + ".frames"));
  // Finished, nothing is rendered again; with another option everything is.
  const auto before = fs::last_write_time(killed.string() + ".frames/000003.png");
  ASSERT_EQ(run_program(with(killed)).exit_code, 0);
  EXPECT_EQ(fs::last_write_time(killed.string() + ".frames/000003.png"), before);
  auto other = with(killed);
  other.insert(other.end(), {"--tour.fov", "60"});
  ASSERT_EQ(run_program(other).exit_code, 0);
  EXPECT_NE(fs::last_write_time(killed.string() + ".frames/000003.png"), before);
}

TEST_F(Tours, FramesFromAToBAreThoseOfTheWholeTour) {
  const fs::path whole = fresh("all"), parts = fresh("parts"), video = fresh("part.mp4");
  const auto with = [&](const fs::path& output, std::vector<std::string> more) {
    more.insert(more.end(), {"-o", output.string(), "--tour.seconds", "1", "--quiet"});
    return tour(more);
  };
  ASSERT_EQ(with(whole, {}).exit_code, 0);
  ASSERT_EQ(with(parts, {"--frames", "7:"}).exit_code, 0);
  EXPECT_FALSE(fs::exists(parts / "000006.png"));
  EXPECT_TRUE(fs::exists(parts / "000010.png"));
  ASSERT_EQ(with(parts, {"--frames", ":3"}).exit_code, 0);
  ASSERT_EQ(with(parts, {"--frames", "3:7"}).exit_code, 0);
  EXPECT_EQ(files_of(whole), files_of(parts));
  ASSERT_EQ(with(video, {"--frames", "2:6"}).exit_code, 0);
  EXPECT_EQ(frames_of(video), 4);
  for (const char* bad : {"5", "5:5", "0:12", "-1:3", "a:b"}) {
    EXPECT_EQ(with(fresh("bad"), {fmt::format("--frames={}", bad)}).exit_code, 2) << bad;
  }
}

TEST_F(Tours, AWalkGoesThroughFreeSpaceOrSaysWhyNot) {
  const fs::path pictures = fresh("walk");
  const std::vector<std::string> options = {"--path",           "walk", "-o", pictures.string(), "--preview", "--quiet",
                                            "--tour.clearance", "0.02"};
  const auto walk = [&](std::vector<std::string> more) {
    more.insert(more.end(), options.begin(), options.end());
    return tour(more);
  };
  // The first camera sees nothing of where it stands; the program says where one could begin and end.
  const auto place_in = [](const std::string& text) {
    for (const std::string before : {"nearest place to stand is ", "one gets as far as "}) {
      const size_t at = text.find(before);
      if (at != std::string::npos)
        return text.substr(at + before.size(), text.find_first_of(";\n", at) - at - before.size());
    }
    return std::string();
  };
  const std::string from = place_in(walk({"--from", "-30,0", "--to", "-30,0"}).output);
  ASSERT_NE(from, "");
  std::string to = place_in(walk({"--from", from, "--to", "30,0.3"}).output);
  auto good = walk({"--from", from, "--to", to});
  if (good.exit_code != 0) {
    to = place_in(good.output);
    good = walk({"--from", from, "--to", to});
  }
  ASSERT_EQ(good.exit_code, 0) << good.output;
  const auto record = nlohmann::json::parse(read_file(pictures / "tour.json"));
  double x = 0, y = 0;
  ASSERT_EQ(std::sscanf(to.c_str(), "%lf,%lf", &x, &y), 2);
  const auto& last = record["frames"].back()["world_from_camera"];
  EXPECT_NEAR(last[3].get<double>(), x, 0.06);
  EXPECT_NEAR(last[7].get<double>(), y, 0.06);

  // Wherever one gets with a small clearance, a large one says which smaller one is enough, and that one is.
  const auto with_clearance = [&](const std::string& clearance) {
    return tour({"--path", "walk", "-o", pictures.string(), "--preview", "--quiet", "--frames", "0:1", "--from", from,
                 "--to", to, "--tour.clearance", clearance});
  };
  std::string advice;
  for (const char* clearance : {"0.025", "0.05", "0.1", "0.2", "0.4"}) {
    const auto refused = with_clearance(clearance);
    if (refused.exit_code == 0) continue;
    EXPECT_EQ(refused.exit_code, 2) << refused.output;
    const std::string before = "; with --tour.clearance ";
    const size_t at = refused.output.find(before);
    ASSERT_NE(at, std::string::npos) << refused.output;
    advice = refused.output.substr(at + before.size());
    advice = advice.substr(0, advice.find(' '));
    EXPECT_LT(std::stod(advice), std::stod(clearance));
    EXPECT_EQ(with_clearance(advice).exit_code, 0) << advice;
    break;
  }
  EXPECT_NE(advice, "");

  const auto unknown = walk({"--from", from, "--to", "-50,3"});
  EXPECT_EQ(unknown.exit_code, 2);
  EXPECT_THAT(unknown.output,
              AllOf(HasSubstr("-50.00,3.00 lies where the map knows nothing"), HasSubstr("nearest place to stand is")));
  EXPECT_EQ(walk({"--from", "0,0"}).exit_code, 2);
  EXPECT_EQ(walk({"--from", "0", "--to", "1,1"}).exit_code, 2);
  EXPECT_EQ(tour({"-o", "x.mp4", "--from", "0,0"}).exit_code, 2);
  EXPECT_EQ(tour({"-o", "x.mp4", "--at", "0,0"}).exit_code, 2);
  EXPECT_EQ(tour({"-o", "x.mp4", "--path", "panorama", "--pannellum", "/tmp"}).exit_code, 2);
  EXPECT_EQ(tour({"-o", "x.jpg"}).exit_code, 2);
  EXPECT_EQ(tour({"-o", "x.mp4", "--path", "nowhere.json"}).exit_code, 2);
  const auto sideways = tour({"-o", "x.mp4", "--path", "sideways"});
  EXPECT_EQ(sideways.exit_code, 2);
  EXPECT_THAT(sideways.output,
              AllOf(HasSubstr("--path sideways"), HasSubstr("one of along, orbit, walk, panorama, follow, fixed")));
  EXPECT_EQ(tour({"-o", (folder_->path() / "session").string()}).exit_code, 3);  // holds other files
}

TEST_F(Tours, DynamicViewsShowEachMomentItself) {
  // Read from the session, frame by frame: with the session gone the stored views are all there is.
  const fs::path moments = fresh("moments"), stored = fresh("stored");
  const std::vector<std::string> common = {"--path", "fixed", "--dynamic", "--quiet", "--tour.swing", "10"};
  const auto with = [&](const fs::path& output) {
    std::vector<std::string> more = {"-o", output.string()};
    more.insert(more.end(), common.begin(), common.end());
    return tour(more);
  };
  const auto result = with(moments);
  ASSERT_EQ(result.exit_code, 0) << result.output;
  fs::rename(folder_->path() / "session", folder_->path() / "away");
  const auto without = with(stored);
  fs::rename(folder_->path() / "away", folder_->path() / "session");
  ASSERT_EQ(without.exit_code, 0) << without.output;
  EXPECT_THAT(without.output, HasSubstr("the stored views are used instead"));
  const auto covered = [](const fs::path& file) {
    const cv::Mat3b image = cv::imread(file.string());
    return std::count_if(image.begin(), image.end(), [](const cv::Vec3b& p) { return p != cv::Vec3b(0, 0, 0); });
  };
  EXPECT_GT(covered(moments / "000005.png"), 160 * 120 / 2);
  EXPECT_GT(covered(stored / "000005.png"), 160 * 120 / 2);
}

TEST_F(Tours, ARobotIsDrawnAtTheRecordingCamera) {
  const fs::path model = folder_->path() / "robot.obj";
  write_file(model, "v -100 -100 -100\nv 100 -100 -100\nv 0 100 -100\nv 0 0 100\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n");
  const fs::path bare = fresh("bare"), with = fresh("with");
  const std::vector<std::string> options = {
      "--tour.seconds",     "0.2",  "--quiet", "--tour.draw_camera", "false", "--tour.draw_path", "false",
      "--tour.robot_scale", "0.001"};
  auto first = arguments({"-o", bare.string()}), second = arguments({"-o", with.string(), "--robot", model.string()});
  first.insert(first.end(), options.begin(), options.end());
  second.insert(second.end(), options.begin(), options.end());
  ASSERT_EQ(run_program(first).exit_code, 0);
  ASSERT_EQ(run_program(second).exit_code, 0);
  const cv::Mat3b a = cv::imread((bare / "000001.png").string()), b = cv::imread((with / "000001.png").string());
  int changed = 0, far = 0;
  for (int y = 0; y < a.rows; ++y) {
    for (int x = 0; x < a.cols; ++x) {
      if (a(y, x) == b(y, x)) continue;
      ++changed;
      far += x < a.cols / 4 || x > 3 * a.cols / 4;
    }
  }
  EXPECT_GT(changed, 20);
  EXPECT_EQ(far, 0);
}

TEST_F(Tours, PanoramasAreClickedThroughInABrowser) {
  const fs::path tools = fs::path(IRIS_SOURCE_DIR) / "tests/tools";
  const fs::path pannellum = tools / "node_modules/pannellum/build";
  const fs::path folder = fresh("panoramas"), file = fresh("panoramas.html");
  const auto with = [&](const fs::path& output, const std::vector<std::string>& more) {
    std::vector<std::string> all = {"--path", "panorama",         "-o", output.string(),    "--panorama.spacing",
                                    "0.12",   "--panorama.nodes", "5",  "--panorama.width", "512",
                                    "--quiet"};
    all.insert(all.end(), more.begin(), more.end());
    return tour(all);
  };
  const auto plain = with(folder, {});
  ASSERT_EQ(plain.exit_code, 0) << plain.output;
  const auto record = nlohmann::json::parse(read_file(folder / "tour.json"));
  ASSERT_EQ(record["nodes"].size(), 5u);
  EXPECT_EQ(cv::imread((folder / "000004.jpg").string()).size(), cv::Size(512, 256));
  EXPECT_THAT(read_file(folder / "index.html"), HasSubstr("https://cdn.jsdelivr.net/npm/pannellum"));
  // Links lead to where the neighbours are: x is the middle of the panorama, -y to the right of it.
  for (size_t i = 0; i < 5; ++i) {
    const auto& scene = record["pannellum"]["scenes"][fmt::format("node{}", i)];
    EXPECT_FALSE(scene["hotSpots"].empty());
    for (const auto& spot : scene["hotSpots"]) {
      const size_t k = std::stoul(spot["sceneId"].get<std::string>().substr(4));
      const auto &a = record["nodes"][i]["position"], &b = record["nodes"][k]["position"];
      const double yaw = spot["yaw"].get<double>() * M_PI / 180;
      const double dx = b[0].get<double>() - a[0].get<double>(), dy = b[1].get<double>() - a[1].get<double>();
      EXPECT_NEAR(std::cos(yaw) * dx - std::sin(yaw) * dy, std::hypot(dx, dy), 1e-9);
    }
  }
  EXPECT_EQ(with(fresh("x"), {"--pannellum", tools.string()}).exit_code, 3);
  EXPECT_EQ(with(fresh("x"), {"--at", "-40,0"}).exit_code, 2);

  if (std::system("node --version >/dev/null 2>&1") != 0 || std::system("chromium --version >/dev/null 2>&1") != 0 ||
      !fs::exists(pannellum / "pannellum.js")) {
    GTEST_SKIP() << "skipped: no node, no Chromium or no Pannellum (npm --prefix " << tools.string() << " install)";
  }
  ASSERT_EQ(with(folder, {"--pannellum", pannellum.string()}).exit_code, 0);
  ASSERT_EQ(with(file, {"--pannellum", pannellum.string()}).exit_code, 0);
  EXPECT_FALSE(fs::exists(file.string() + ".frames"));
  EXPECT_EQ(read_file(folder / "index.html").find("https://cdn"), std::string::npos);
  // A way along the links that visits all five.
  std::vector<int> way = {0}, unseen = {1, 2, 3, 4};
  const auto links = [&](int i) { return record["nodes"][static_cast<size_t>(i)]["links"].get<std::vector<int>>(); };
  const std::function<bool(int, std::vector<bool>, int)> visit = [&](int at, std::vector<bool> seen, int left) {
    if (left == 0) return true;
    // Depth first, coming back the way it went.
    for (const int k : links(at)) {
      if (seen[static_cast<size_t>(k)]) continue;
      seen[static_cast<size_t>(k)] = true;
      way.push_back(k);
      if (visit(k, seen, left - 1)) return true;
      way.pop_back();
      seen[static_cast<size_t>(k)] = false;
    }
    return false;
  };
  ASSERT_TRUE(visit(0, {true, false, false, false, false}, 4)) << record["nodes"].dump();
  std::string order;
  for (const int k : way) order += fmt::format("{}{}", order.empty() ? "" : ",", k);
  for (const fs::path& output : {folder, file}) {
    const std::string log = fresh("clicks.txt").string();
    const int code = std::system(("node '" + (tools / "click_tour.mjs").string() + "' '" + output.string() + "' " +
                                  order + " >'" + log + "' 2>&1")
                                     .c_str());
    EXPECT_EQ(code, 0) << read_file(log);
    for (int i = 0; i < 5; ++i) EXPECT_THAT(read_file(log), HasSubstr(fmt::format("visited node{}", i)));
  }
}

TEST_F(Tours, ViewsAreExportedForOtherTools) {
  ASSERT_EQ(run_program({"export", out().string(), "--only", "colmap,nerfstudio", "--quiet"}).exit_code, 0);
  for (const char* file : {"colmap/sparse/0/cameras.txt", "colmap/sparse/0/images.txt", "colmap/sparse/0/points3D.txt",
                           "colmap/images/000000.png", "nerfstudio/transforms.json", "nerfstudio/images/000000.png",
                           "nerfstudio/depth/000000.png", "nerfstudio/sparse_pc.ply"}) {
    EXPECT_TRUE(fs::exists(out() / file)) << file;
  }
}

}  // namespace
}  // namespace iris
