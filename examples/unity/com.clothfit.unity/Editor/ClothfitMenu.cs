using System;
using System.IO;
using System.Linq;
using UnityEditor;
using UnityEngine;
using UnityEngine.SceneManagement;

namespace Clothfit.Editing
{
    /// <summary>The menu Clothfit.</summary>
    public static class ClothfitMenu
    {
        const string Menu = "Clothfit/";

        [MenuItem(Menu + "Export", false, 1)]
        public static void Export()
        {
            Try(() => Debug.Log("Clothfit: wrote " + Written(Chosen())));
        }

        [MenuItem(Menu + "Estimate", false, 2)]
        public static void Estimate()
        {
            Try(() =>
            {
                ClothfitScene settings = Chosen();
                Command command = ClothfitPreferences.Chosen();
                string scene = Written(settings), fitted = ProjectFiles.Fitted(settings);
                BackgroundFit.Start(new EstimateRun(command, scene, fitted, settings, ProjectFiles.Folder), settings.name);
            });
        }

        [MenuItem(Menu + "Estimate", true)]
        public static bool MayEstimate()
        {
            return !BackgroundFit.Runs;
        }

        [MenuItem(Menu + "Cancel", false, 3)]
        public static void Cancel()
        {
            BackgroundFit.Cancel();
        }

        [MenuItem(Menu + "Cancel", true)]
        public static bool MayCancel()
        {
            return BackgroundFit.Runs;
        }

        [MenuItem(Menu + "Import fitted", false, 4)]
        public static void Import()
        {
            Try(() =>
            {
                ClothfitScene settings = Chosen();
                string path = ProjectFiles.Fitted(settings);
                if (!File.Exists(path)) throw new InvalidOperationException(path + " does not exist; estimate first");
                SceneFile file = SceneFile.Read(path);
                foreach (MonoBehaviour each in SceneImport.Changed(settings)) Undo.RecordObject(each, "Import fitted values");
                SceneImport.Apply(file, settings);
                foreach (MonoBehaviour each in SceneImport.Changed(settings)) EditorUtility.SetDirty(each);
                Debug.Log("Clothfit: took the values of " + path);
            });
        }

        [MenuItem(Menu + "Simulate and play", false, 21)]
        public static void Play()
        {
            Try(() =>
            {
                ClothfitScene settings = Chosen();
                string motion = ProjectFiles.Motion(settings, "motion"), scene = Written(settings);
                Run(settings, new[] { "simulate", scene, "-o", motion }, "simulates", () => Players.Attach(settings, motion));
            });
        }

        [MenuItem(Menu + "Show target", false, 22)]
        public static void ShowTarget()
        {
            Try(() =>
            {
                ClothfitScene settings = Chosen();
                if (settings.target.Length == 0) throw new InvalidOperationException(settings.name + ": names no target");
                string motion = ProjectFiles.Motion(settings, "target"), scene = Written(settings);
                string[] call = { "convert", settings.target, motion, "--scene", scene };
                Run(settings, call, "converts", () => Players.AttachGhosts(settings, motion));
            });
        }

        [MenuItem(Menu + "New scene", false, 41)]
        public static void New()
        {
            var root = new GameObject("Clothfit scene", typeof(ClothfitScene));
            var cloth = new GameObject("Cloth", typeof(MeshFilter), typeof(MeshRenderer), typeof(ClothfitPlane), typeof(ClothfitCloth));
            var fixer = new GameObject("Fixer", typeof(ClothfitFixer));
            var plane = cloth.GetComponent<ClothfitPlane>();
            plane.Make();
            cloth.transform.SetParent(root.transform, false);
            fixer.transform.SetParent(root.transform, false);
            fixer.transform.localPosition = new Vector3(-plane.width / 2, 0f, 0f);
            fixer.transform.localScale = new Vector3(0.1f * plane.width, 0.1f * plane.width, 1.1f * plane.length);
            Undo.RegisterCreatedObjectUndo(root, "New Clothfit scene");
            Selection.activeGameObject = root;
        }

        /// <summary>The scene that is meant: of what is selected, or the only one.</summary>
        static ClothfitScene Chosen()
        {
            GameObject selected = Selection.activeGameObject;
            ClothfitScene settings = selected == null ? null : selected.GetComponentInParent<ClothfitScene>();
            if (settings != null) return settings;
            // the searches of Object differ between versions of Unity
            ClothfitScene[] all = Enumerable.Range(0, SceneManager.sceneCount).Select(SceneManager.GetSceneAt)
                .Where(each => each.isLoaded).SelectMany(each => each.GetRootGameObjects())
                .SelectMany(each => each.GetComponentsInChildren<ClothfitScene>()).ToArray();
            if (all.Length == 1) return all[0];
            throw new InvalidOperationException(all.Length == 0 ? "there is no Clothfit Scene; make one with Clothfit > New scene"
                : "there are several Clothfit Scenes; select one");
        }

        static string Written(ClothfitScene settings)
        {
            string path = ProjectFiles.Scene(settings);
            SceneBuilder.Build(settings).Write(path);
            return path;
        }

        static void Run(ClothfitScene settings, string[] arguments, string does, Action done)
        {
            var run = new CommandRun(ClothfitPreferences.Chosen().Call(arguments, ProjectFiles.Folder));
            BackgroundCall.Start(run, settings.name + ": " + does, done);
        }

        static void Try(Action action)
        {
            try
            {
                action();
            }
            catch (Exception error) when (error is InvalidOperationException || error is FormatException || error is IOException
                || error is UnauthorizedAccessException)
            {
                Debug.LogError("Clothfit: " + error.Message);
                EditorUtility.DisplayDialog("Clothfit", error.Message, "OK");
            }
        }
    }
}
