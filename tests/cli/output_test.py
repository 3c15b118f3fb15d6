"""Where results go: folders that are missing, full or closed; names that are strange; the environment."""

import os
import resource
import shutil
import subprocess
import unittest

from support import (CANNOT_WRITE, COOL, DONE, JOINT, LAVA, LIMIT, RECIPE, RENDER, USAGE, WEATHER, SceneTest, bash, environment,
                     files_in, run, small_disk, start, temporaries)


class Targets(SceneTest):
    def test_an_existing_file_is_replaced_only_by_force(self):
        self.write("out.vdb", "precious")
        self.refuse(USAGE, ["out.vdb", "--force"], "cool", self.lava, "-o", "out.vdb")
        self.succeed("cool", self.lava, *COOL, "--seed", 7, "-o", "out.vdb", "--force")
        self.assertSameBytes(self.folder / "out.vdb", self.cooled)

    def test_output_may_be_the_input_only_by_force(self):
        shutil.copy(self.lava, self.folder / "scene.vdb")
        self.refuse(USAGE, ["scene.vdb", "--force"], "cool", "scene.vdb", "-o", "scene.vdb")
        self.refuse(USAGE, ["--force"], "cool", "scene.vdb", "-o", "./scene.vdb")
        os.link(self.folder / "scene.vdb", self.folder / "hard.vdb")
        self.succeed("cool", "scene.vdb", *COOL, "--seed", 7, "-o", "scene.vdb", "--force")
        self.assertSameBytes(self.folder / "scene.vdb", self.cooled)
        self.assertSameBytes(self.folder / "hard.vdb", self.lava, "another name of the old file keeps the old content")

    def test_a_mesh_beside_a_scene_is_replaced_only_by_force_too(self):
        self.write("rock.ply", "precious")
        self.refuse(USAGE, ["rock.ply", "--force"], "mesh", self.weathered, "-o", "rock.vdb")
        self.succeed("mesh", self.weathered, "-o", "rock.vdb", "--force")
        self.assertSameBytes(self.folder / "rock.ply", self.mesh)
        grids = {g["name"] for g in self.succeed("info", "rock.vdb", "--json").json()[0]["grids"]}
        self.assertIn("temperature", grids, "a scene keeps what the command did not make")

    def test_39_folders_that_cannot_take_a_file(self):
        self.write("file", "a file")
        (self.folder / "folder.vdb").mkdir()
        for target, words in (("missing/out.vdb", ["missing", "no such folder"]), ("file/out.vdb", ["file", "expected a folder"]),
                              ("folder.vdb", ["folder.vdb", "folder"])):
            with self.subTest(target=target):
                # Said before anything is computed: ten million steps take longer than a refusal may.
                self.refuse(CANNOT_WRITE, words, "cool", self.lava, "--steps", "9999999", "-o", target)
        self.recipe()
        self.refuse(CANNOT_WRITE, ["file"], "run", "rock.toml", "--set", "out=file")
        self.refuse(CANNOT_WRITE, ["file"], "run", "rock.toml", "--set", "out=file/below")
        self.succeed("run", "rock.toml", "--set", "out=new/folder/below", "--only", "lava", "-q")

    def test_39_a_read_only_folder(self):
        with small_disk(self.folder / "disk", "size=4m") as disk:
            subprocess.run(["mount", "-o", "remount,ro", str(disk)], check=True)
            self.refuse(CANNOT_WRITE, ["disk", "read-only"], "cool", self.lava, "--steps", "9999999", "-o", "disk/out.vdb")
            self.recipe()
            self.refuse(CANNOT_WRITE, ["disk", "read-only"], "run", "rock.toml", "--set", "out=disk/out")

    def test_39_a_folder_of_somebody_else(self):
        if os.getuid() == 0:
            self.skipTest("root may write everywhere")
        (self.folder / "closed").mkdir(mode=0o555)
        self.refuse(CANNOT_WRITE, ["closed", "permission"], "cool", self.lava, "-o", "closed/out.vdb")

    def test_40_a_full_disk_names_need_and_space_and_keeps_the_old_file(self):
        with small_disk(self.folder / "disk", "size=64k") as disk:
            (disk / "out.vdb").write_bytes(b"old")
            for command, source, options, name in (("lava", None, LAVA, "out.vdb"), ("cool", self.lava, COOL, "out.vdb"),
                                                   ("joint", self.cooled, JOINT, "out.vdb"),
                                                   ("weather", self.joints, WEATHER, "out.vdb"), ("mesh", self.weathered, [], "out.ply"),
                                                   ("mesh", self.weathered, [], "out.obj"), ("mesh", self.weathered, [], "out.glb")):
                with self.subTest(command=command, name=name):
                    done = self.refuse(CANNOT_WRITE, [name, "no space", "needed", "free"], command, *([source] if source else []),
                                       *options, "--force", "-o", disk / name)
            self.assertEqual((disk / "out.vdb").read_bytes(), b"old")
            self.assertEqual([p.name for p in disk.iterdir()], ["out.vdb"])
        with small_disk(self.folder / "disk", "size=8m"):
            self.succeed("cool", self.lava, *COOL, "-o", "disk/out.vdb")

    def test_40_a_disk_that_fills_at_any_byte_of_a_run(self):
        self.recipe()
        self.succeed("run", "rock.toml", "-q", "--set", "out=good")
        good = files_in(self.folder / "good")
        whole = sum(len(c) for c in files_in(self.folder / "good", hidden=True).values())
        (self.folder / "disk").mkdir()
        for share in (0.02, 0.2, 0.4, 0.6, 0.8, 0.9, 0.97):
            with self.subTest(share=share), small_disk(self.folder / "disk", f"size={int(whole * share) // 4096 * 4}k") as disk:
                done = self.run_in_folder("run", "rock.toml", "-q", "--set", f"out={disk}/out")
                self.assertEqual(done.code, CANNOT_WRITE, done)
                self.assertIn("no space", done.err)
                self.assertEqual(temporaries(disk), [])
                for name, content in files_in(disk / "out").items():
                    self.assertSameBytes(content, good[name], name)
                # More room, and it goes on to the same end.
                subprocess.run(["mount", "-o", f"remount,size={whole * 4}", str(disk)], check=True)
                self.succeed("run", "rock.toml", "-q", "--set", f"out={disk}/out")
                self.assertSameFiles(files_in(disk / "out"), good)

    def test_40_devices_and_full_pipes(self):
        (self.folder / "device.vdb").symlink_to("/dev/full")
        self.refuse(CANNOT_WRITE, ["pipe or device"], "cool", self.lava, "-o", "device.vdb", "--force")
        for arguments in (f"mesh {self.weathered} -o -", f"cool {self.lava} -o -", f"info {self.lava}", "schema", "completions bash",
                          f"cool {self.lava} -o x.vdb --force --json", f"replay {self.lava}", f"render {self.mesh} --width 64 --samples 1 -o -"):
            done = bash(f'"$SEKITEI" {arguments} > /dev/full', self.folder)
            self.assertEqual(done.code, CANNOT_WRITE, f"{arguments}: {done}")
            self.assertRegex(done.err, "cannot write to (standard output|the pipe)")

    def test_41_names(self):
        for name in ("苔.vdb", "with space.vdb", "-dash.vdb", "x" * 251 + ".vdb", "é" * 125 + "x.vdb", "a\nb.vdb", "*.vdb", ".hidden.vdb",
                     "%n%s.vdb"):
            with self.subTest(name=name):
                self.succeed("cool", self.lava, *COOL, "--seed", 7, "-o", f"./{name}")
                self.assertSameBytes(self.folder / name, self.cooled)
                self.succeed("joint", f"./{name}", *JOINT, "-o", "next.vdb", "--force")
                self.succeed("info", f"./{name}")
        self.assertEqual(temporaries(self.folder), [])
        self.refuse(CANNOT_WRITE, ["256 bytes"], "cool", self.lava, "-o", "x" * 252 + ".vdb")

    def test_41_symbolic_links_are_followed_and_stay(self):
        (self.folder / "elsewhere").mkdir()
        (self.folder / "link.vdb").symlink_to("elsewhere/real.vdb")
        self.succeed("cool", self.lava, *COOL, "--seed", 7, "-o", "link.vdb")
        self.assertTrue((self.folder / "link.vdb").is_symlink())
        self.assertSameBytes(self.folder / "elsewhere/real.vdb", self.cooled)
        self.refuse(USAGE, ["link.vdb", "--force"], "cool", self.lava, "-o", "link.vdb")
        (self.folder / "broken.vdb").symlink_to("nowhere/real.vdb")
        self.refuse(CANNOT_WRITE, ["broken.vdb", "no such folder"], "cool", self.lava, "-o", "broken.vdb")
        (self.folder / "circle.vdb").symlink_to("circle.vdb")
        self.refuse(CANNOT_WRITE, ["circle.vdb"], "cool", self.lava, "-o", "circle.vdb")

    def test_41_pipes_with_names_are_refused_and_do_not_hang(self):
        os.mkfifo(self.folder / "pipe.vdb")
        self.refuse(CANNOT_WRITE, ["pipe.vdb", "use -"], "cool", self.lava, "-o", "pipe.vdb", "--force")

    def test_two_outputs_of_one_name_are_told(self):
        self.refuse(USAGE, ["twice"], "mesh", self.weathered, "-o", "a.ply", "-o", "./a.ply")
        self.refuse(USAGE, ["twice"], "mesh", self.weathered, "-o", "-", "-o", "-")


class Surroundings(SceneTest):
    def test_42_a_reader_that_goes_away(self):
        for arguments in (f"mesh {self.weathered} -o -", f"cool {self.lava} -o -", "schema", f"info {self.weathered}"):
            done = bash(f'"$SEKITEI" {arguments} -q | head -c 100 > taken; echo "${{PIPESTATUS[0]}}"', self.folder)
            self.assertIn(int(done.out), (DONE, CANNOT_WRITE, 141), f"{arguments}: {done}")
            self.assertNotIn("terminate", done.err)
            self.assertNotIn("bug", done.err)
        self.assertEqual(temporaries(self.folder), [])

    def test_42_closed_standard_input(self):
        done = bash(f'"$SEKITEI" cool - -o x.vdb <&-', self.folder)
        self.assertEqual(done.code, 3, done)
        self.succeed("cool", self.lava, *COOL, "-o", "y.vdb")
        done = bash(f'"$SEKITEI" cool {self.lava} {" ".join(COOL)} --seed 7 -o z.vdb <&-', self.folder)
        self.assertEqual(done.code, DONE, done)
        self.assertSameBytes(self.folder / "z.vdb", self.cooled)

    def test_44_closed_standard_output_and_error(self):
        done = bash(f'"$SEKITEI" info {self.lava} >&-', self.folder)
        self.assertEqual(done.code, CANNOT_WRITE, done)
        for closed in (">&-", "2>&-", ">&- 2>&-", "<&- >&- 2>&-"):
            done = bash(f'"$SEKITEI" joint {self.cooled} {" ".join(JOINT)} --seed 7 -v -o x.vdb --force {closed}', self.folder)
            self.assertEqual(done.code, DONE, f"{closed} {done}")
            self.assertSameBytes(self.folder / "x.vdb", self.joints, closed)
        self.recipe()
        for i, closed in enumerate((">&-", "2>&-", "<&- >&- 2>&-")):
            done = bash(f'"$SEKITEI" run rock.toml -v --set out=out{i} {closed}', self.folder)
            self.assertEqual(done.code, DONE, f"{closed} {done}")
            self.assertEqual((self.folder / f"out{i}/.sekitei/lock").stat().st_size, 0, "words went into a file")
            self.assertSameBytes(self.folder / f"out{i}/rock.vdb", self.weathered, closed)

    def test_44_little_address_space(self):
        # The whole chain in 2 GB of address space gives the same files.
        limits = [(resource.RLIMIT_AS, 2 << 30)]
        self.succeed("lava", *LAVA, "--seed", 7, "-o", "lava.vdb", limits=limits)
        self.succeed("cool", "lava.vdb", *COOL, "--seed", 7, "-o", "cooled.vdb", limits=limits)
        self.succeed("joint", "cooled.vdb", *JOINT, "--seed", 7, "-o", "joints.vdb", limits=limits)
        self.succeed("weather", "joints.vdb", *WEATHER, "--seed", 7, "-o", "weathered.vdb", limits=limits)
        self.succeed("mesh", "weathered.vdb", "-o", "rock.ply", limits=limits)
        self.succeed("render", "rock.ply", *RENDER, "--seed", 7, "-o", "rock.png", limits=limits)
        for name in ("lava.vdb", "cooled.vdb", "joints.vdb", "weathered.vdb", "rock.ply", "rock.png"):
            self.assertSameBytes(self.folder / name, self.scenes / name)

    def test_44_too_little_address_space_is_a_limit(self):
        for megabytes in (60, 120, *range(140, 180, 3), 200, 250, 300):
            limits = [(resource.RLIMIT_AS, megabytes << 20)]
            if run("--version", limits=limits).code != DONE:
                continue  # the loader or a library gives up before main() begins
            done = self.run_in_folder("joint", self.cooled, *JOINT, "-o", f"x{megabytes}.vdb", limits=limits)
            self.assertIn(done.code, (DONE, LIMIT), f"{megabytes} MB: {done}")
            self.assertEqual(temporaries(self.folder), [])

    def test_44_few_open_files_and_little_stack(self):
        self.succeed("joint", self.cooled, *JOINT, "--seed", 7, "-o", "x.vdb", limits=[(resource.RLIMIT_NOFILE, 16), (resource.RLIMIT_STACK, 1 << 20)])
        self.assertSameBytes(self.folder / "x.vdb", self.joints)

    def test_44_files_of_a_limited_size(self):
        done = self.run_in_folder("joint", self.cooled, *JOINT, "-o", "x.vdb", limits=[(resource.RLIMIT_FSIZE, 20_000)])
        self.assertEqual(done.code, CANNOT_WRITE, done)
        self.assertEqual(list(self.folder.iterdir()), [])

    def test_44_ten_thousand_threads(self):
        self.succeed("joint", self.cooled, *JOINT, "--seed", 7, "--threads", "10000", "-o", "x.vdb")
        self.assertSameBytes(self.folder / "x.vdb", self.joints)

    def test_44_an_empty_environment(self):
        self.succeed("joint", self.cooled, *JOINT, "--seed", 7, "-o", "x.vdb", env={"PATH": ""})
        self.assertSameBytes(self.folder / "x.vdb", self.joints)
        nowhere = environment(HOME="/nonexistent", TMPDIR="/nonexistent", TERM="nonsense", LC_ALL="nonsense")
        self.succeed("joint", self.cooled, *JOINT, "--seed", 7, "-o", "y.vdb", env=nowhere)
        self.assertSameBytes(self.folder / "y.vdb", self.joints)


if __name__ == "__main__":
    unittest.main()
