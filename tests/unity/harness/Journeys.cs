// Whole journeys through the menu, in a folder of a project: export, estimate, import; and what can go wrong.

using System;
using System.Globalization;
using System.IO;
using System.Linq;
using System.Text.RegularExpressions;
using System.Threading;
using Clothfit;
using Clothfit.Editing;
using UnityEditor;
using UnityEngine;
using Debug = UnityEngine.Debug;

static class Journeys
{
    const int Pause = 20; // ms between two looks, as the editor's update has them
    const double Limit = 300; // s

    public static void Print(Vector3 place)
    {
        Console.WriteLine(string.Format(CultureInfo.InvariantCulture, "{0:R} {1:R} {2:R}", place.x, place.y, place.z));
    }

    public static void Run(string what, string scene, string project, string program)
    {
        Application.dataPath = Path.Combine(project, "Assets");
        ClothfitPreferences.Program = program;
        ClothfitPreferences.FirstArguments = program == Command.Name ? "" : "-m clothfit";
        ClothfitScene settings = Scenes.Named(scene);
        Selection.activeGameObject = settings.gameObject;
        switch (what)
        {
            case "fit": Fit(settings); break;
            case "cancel": Cancel(() => Progress.Lines.Last().Cancel()); break;
            case "menu-cancel": Cancel(ClothfitMenu.Cancel); break;
            case "quit": Cancel(EditorApplication.Quit); break;
            case "reload": Cancel(AssemblyReloadEvents.Reload); break;
            case "abandon": Abandon(); break;
            case "target": Target(settings); break;
            case "lost": settings.target = "no such file.npz"; goto case "try";
            case "play": Play(settings); break;
            case "try": ClothfitMenu.Estimate(); Wait(() => !BackgroundFit.Runs); break;
            case "import": ClothfitMenu.Import(); break;
            default: throw new ArgumentException(what);
        }
        foreach (string each in Debug.Said) Console.WriteLine("said: " + each.Replace("\n", " | "));
        foreach (string each in Debug.Faults) Console.WriteLine("fault: " + each);
        foreach (string each in EditorUtility.Dialogs) Console.WriteLine("dialog: " + each);
        foreach (Progress.Line each in Progress.Lines) Console.WriteLine("progress: " + each.Name + ": " + each.Status);
    }

    /// <summary>Calls the editor's update until something is so; returns the descriptions of the progress meanwhile.</summary>
    static string Wait(Func<bool> so)
    {
        DateTime end = DateTime.UtcNow.AddSeconds(Limit);
        string seen = "";
        while (!so())
        {
            if (DateTime.UtcNow > end) throw new TimeoutException(seen);
            EditorApplication.Tick();
            string now = Progress.Lines.Count == 0 ? "" : Progress.Lines.Last().Description ?? "";
            if (!seen.EndsWith(now, StringComparison.Ordinal)) seen += "\n" + now;
            Thread.Sleep(Pause);
        }
        return seen;
    }

    static void Fit(ClothfitScene settings)
    {
        ClothfitMenu.Export();
        ClothfitMenu.Estimate();
        Console.WriteLine("may start another: " + ClothfitMenu.MayEstimate());
        Console.WriteLine("seen: " + Wait(() => !BackgroundFit.Runs).Replace("\n", " | "));
        ClothfitMenu.Import();
        Console.WriteLine("undo: " + Undo.Recorded.Count);
        SceneBuilder.Build(settings).Write(Path.Combine(ProjectFiles.Folder, "again.txt"));
        foreach (ClothfitCloth cloth in settings.All<ClothfitCloth>()) Messages.Send(cloth, "OnDrawGizmosSelected");
        Console.WriteLine("springs: " + Gizmos.Lines.Count + " colours: " + Gizmos.Lines.Select(line => line.Colour).Distinct().Count());
    }

    /// <summary>Cancels once the fit is better than its start.</summary>
    static void Cancel(Action cancel)
    {
        ClothfitMenu.Estimate();
        string first = "";
        Wait(() =>
        {
            string now = Regex.Match(Progress.Lines.Last().Description, "RMSE [^,]+").Value;
            if (first == "") first = now;
            return now != first;
        });
        Console.WriteLine("id: " + BackgroundFit.Id);
        cancel();
        Wait(() => !BackgroundFit.Runs);
    }

    /// <summary>Ends without a word, as an editor that crashes.</summary>
    static void Abandon()
    {
        ClothfitMenu.Estimate();
        Wait(() => Progress.Lines.Last().Description.Contains("RMSE"));
        Console.WriteLine("id: " + BackgroundFit.Id);
        Console.Out.Flush();
        Environment.Exit(9);
    }

    static void Play(ClothfitScene settings)
    {
        ClothfitMenu.Play();
        Wait(() => Progress.Lines.Last().Status != Progress.Status.Running);
        foreach (ClothfitCloth cloth in settings.All<ClothfitCloth>())
        {
            var player = cloth.GetComponent<ClothfitPlayer>();
            player.Show(7 * settings.timeStep);
            foreach (Vector3 each in cloth.GetComponent<MeshFilter>().sharedMesh.vertices) Print(cloth.transform.TransformPoint(each));
            Console.Write("second vertex of the scene: ");
            Print(SceneBuilder.Object(cloth).vertPos[1]);
            player.Close();
        }
    }

    /// <summary>Shows a target as ghosts and draws them.</summary>
    static void Target(ClothfitScene settings)
    {
        settings.target = "target.npz";
        ClothfitMenu.ShowTarget();
        Wait(() => Progress.Lines.Last().Status != Progress.Status.Running);
        foreach (ClothfitPlayer player in settings.All<ClothfitPlayer>())
        {
            Mesh before = player.GetComponent<MeshFilter>().sharedMesh;
            player.Show(7 * settings.timeStep);
            Messages.Send(player, "OnDrawGizmos");
            Console.WriteLine("mesh stays: " + (before == player.GetComponent<MeshFilter>().sharedMesh));
        }
        foreach (Gizmos.Line line in Gizmos.Lines) Print(line.From);
    }
}
