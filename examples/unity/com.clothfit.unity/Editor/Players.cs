using System.Collections.Generic;
using System.Linq;
using UnityEditor;
using UnityEngine;

namespace Clothfit.Editing
{
    /// <summary>Puts players on the cloths of a scene, each with its part of the file.</summary>
    public static class Players
    {
        const string Ghost = "Clothfit target";

        /// <summary>Lets the cloths play a motion.</summary>
        public static void Attach(ClothfitScene settings, string motion)
        {
            int first = 0;
            foreach (ClothfitCloth cloth in settings.All<ClothfitCloth>())
            {
                int count = cloth.Weld().Places.Length;
                var player = cloth.GetComponent<ClothfitPlayer>();
                if (player == null) player = Undo.AddComponent<ClothfitPlayer>(cloth.gameObject);
                player.Close();
                Set(player, settings, motion, first, false);
                first += count;
            }
        }

        /// <summary>Adds an object below each cloth that draws a motion as lines.</summary>
        public static void AttachGhosts(ClothfitScene settings, string motion)
        {
            int first = 0;
            foreach (ClothfitCloth cloth in settings.All<ClothfitCloth>())
            {
                Transform below = cloth.transform.Find(Ghost);
                if (below == null)
                {
                    below = new GameObject(Ghost, typeof(MeshFilter), typeof(ClothfitPlayer)).transform;
                    below.SetParent(cloth.transform, false);
                    Undo.RegisterCreatedObjectUndo(below.gameObject, "Show target");
                }
                var own = cloth.GetComponent<ClothfitMover>();
                Mesh mesh = own != null && own.Original != null ? own.Original : cloth.GetComponent<MeshFilter>().sharedMesh;
                below.GetComponent<MeshFilter>().sharedMesh = mesh;
                var player = below.GetComponent<ClothfitPlayer>();
                player.Close();
                Set(player, settings, motion, first, true);
                first += cloth.Weld().Places.Length;
            }
        }

        static void Set(ClothfitPlayer player, ClothfitScene settings, string motion, int first, bool ghost)
        {
            player.motion = motion;
            player.frameRate = ghost && settings.targetRate > 0 ? settings.targetRate : 1f / settings.timeStep;
            player.firstVertex = first;
            player.ghost = ghost;
            EditorUtility.SetDirty(player);
        }
    }
}
